# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a process of ours does before `rclpy.init`."""
from __future__ import annotations

from msgs_bridge.dead_segments import remove_dead_segments
from msgs_bridge.host_only import stay_on_this_host
from msgs_bridge.log_folder import ensure_log_folder


def before_rclpy() -> None:
    """
    Set the environment for ROS, which child processes inherit, and tidy up after dead nodes.

    Raises:
        BridgeError: the machine lacks something that every node needs.
    """
    stay_on_this_host()
    ensure_log_folder()
    remove_dead_segments()
