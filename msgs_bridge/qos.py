# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""QoS profiles made from the topic table."""
from __future__ import annotations

from msgs_bridge.topics import Topic
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def qos_profile(topic: Topic, *, depth: int | None = None) -> QoSProfile:
    """Return the profile of a topic; a subscription may ask for another depth."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or topic.depth,
        reliability=(
            ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE),
    )
