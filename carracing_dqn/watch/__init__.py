# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A live graph or a bag as one state, what is wrong with it, and two ways to show it."""
