# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators that others wrote, each a thin adapter to `msgs_bridge.simulator.Simulator`."""
