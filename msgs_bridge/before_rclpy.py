# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a process of ours does before `rclpy.init`."""
from __future__ import annotations

import os

from msgs_bridge.errors import BridgeError
from msgs_bridge.host_only import check_profile, stay_on_this_host
from msgs_bridge.log_folder import ensure_log_folder
from msgs_bridge.plain_text import plain

LAST_DOMAIN = 232
"""Above it DDS has no ports."""


def before_rclpy() -> None:
    """
    Set the environment for ROS, which child processes inherit.

    Raises:
        BridgeError: the machine lacks something that every node needs, ROS_DOMAIN_ID is none, or
            Fast DDS would open the graph for want of its profile.
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if not is_domain(domain or '0'):
        raise BridgeError(f'ROS_DOMAIN_ID is {plain(domain, 40)!r}; accepted: 0 to {LAST_DOMAIN}')
    stay_on_this_host()
    check_profile()
    ensure_log_folder()


def is_domain(text: str) -> bool:
    """Return whether a text is a number that ROS_DOMAIN_ID may be; Fast DDS ends us at others."""
    return (text.isascii() and text.isdecimal() and len(text) <= len(str(LAST_DOMAIN))
            and int(text) <= LAST_DOMAIN)
