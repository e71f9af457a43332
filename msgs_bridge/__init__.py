# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The topic contract: names, types, QoS, message <-> array, transitions joined by stamp.

Only `node_shell` and `qos` import rclpy; everything else works without ROS.
"""
