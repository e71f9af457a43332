# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Faults put into the running product on purpose: tables of them, one runner, one oracle."""
