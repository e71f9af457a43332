# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Record, replay, inspect, verify and recover MCAP bags in the layout of rosbag2 Jazzy."""
