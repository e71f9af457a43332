# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""QoS between rclpy's objects and the plain dicts of a bag."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bags.qos_text import duration_dict, offered_qos

# rosbag2's depth for what it plays
PLAY_DEPTH = 10


def recorded_qos(endpoints: Sequence[TopicEndpointInfo]) -> list[dict[str, Any]]:
    """Return the QoS that publishers offer, one profile each, as a bag records it."""
    return [_profile_dict(endpoint.qos_profile) for endpoint in endpoints]


def request_for(profiles: Sequence[dict[str, Any]], depth: int) -> QoSProfile:
    """
    Return the strongest request that every one of the offered profiles meets.

    That is rosbag2's rule: reliable if all are, transient local if all are.
    """
    reliable = all(profile['reliability'] == 'reliable' for profile in profiles)
    latched = all(profile['durability'] == 'transient_local' for profile in profiles)
    return _profile(reliable, latched, depth)


def offer_for(profiles: Sequence[dict[str, Any]]) -> tuple[QoSProfile, bool]:
    """
    Return the profile to play a topic with, and whether its publishers agreed on one.

    rosbag2's rule: the recorded one if all are equal in what matters, else reliable, volatile.
    """
    kinds = {(profile['reliability'] != 'best_effort',
              profile['durability'] == 'transient_local') for profile in profiles}
    reliable, latched = kinds.pop() if len(kinds) == 1 else (True, False)
    return _profile(reliable, latched, PLAY_DEPTH), len(kinds) == 0


def meets(request: QoSProfile, profile: dict[str, Any]) -> bool:
    """Return whether a publisher's profile satisfies a request."""
    if (request.reliability == ReliabilityPolicy.RELIABLE
            and profile['reliability'] != 'reliable'):
        return False
    return not (request.durability == DurabilityPolicy.TRANSIENT_LOCAL
                and profile['durability'] != 'transient_local')


def _profile(reliable: bool, latched: bool, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def _profile_dict(profile: QoSProfile) -> dict[str, Any]:
    result = offered_qos()
    result.update(
        history=_name(HistoryPolicy, profile.history),
        depth=profile.depth,
        reliability=_name(ReliabilityPolicy, profile.reliability),
        durability=_name(DurabilityPolicy, profile.durability),
        deadline=duration_dict(profile.deadline.nanoseconds),
        lifespan=duration_dict(profile.lifespan.nanoseconds),
        liveliness=_name(LivelinessPolicy, profile.liveliness),
        liveliness_lease_duration=duration_dict(profile.liveliness_lease_duration.nanoseconds),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions)
    return result


def _name(policy: type, value: Any) -> str:
    return policy(value).name.lower()
