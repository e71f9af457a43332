# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The topic contract: names, types, QoS, message <-> array, transitions joined by stamp.

The modules of nodes (`node_*`, `adaptive_subscription`, `matching`, `qos`) and `transport` import
rclpy; everything else works without ROS.
"""
