# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""QoS between rclpy's objects and the plain dicts of a bag."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from rclpy.duration import Duration, Infinite
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bags.qos_text import duration_dict, NANOSECONDS, offered_qos

# rosbag2's depth for what it plays
PLAY_DEPTH = 10
# A bag keeps the profile of each publisher of a topic; of more than this many only what differs,
# so that nobody fills `metadata.yaml` by publishing a topic ten thousand times.
MOST_PROFILES = 16
# DDS runs a timer of each deadline, so one of a nanosecond would burn a core; ns
LEAST_DURATION = 1_000_000


class Kind(NamedTuple):
    """What decides whether a publisher and a subscription match, as far as they can ask for it."""

    reliable: bool
    latched: bool


def recorded_qos(endpoints: Sequence[TopicEndpointInfo]) -> list[dict[str, Any]]:
    """Return the QoS that publishers offer, one profile each, as a bag records it."""
    profiles = [_profile_dict(endpoint.qos_profile) for endpoint in endpoints]
    if len(profiles) > MOST_PROFILES:
        profiles = join_profiles([], profiles)
    return profiles[:MOST_PROFILES]


def join_profiles(
    known: Sequence[dict[str, Any]], more: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Return the known profiles and those of the others that are not among them."""
    joined = list(known)
    for profile in more:
        if profile not in joined and len(joined) < MOST_PROFILES:
            joined.append(profile)
    return joined


def kinds_of(profiles: Sequence[dict[str, Any]]) -> frozenset[Kind]:
    """Return the kinds of publishers; a subscription of each hears all of them at their best."""
    return frozenset(
        Kind(profile['reliability'] != 'best_effort', profile['durability'] == 'transient_local')
        for profile in profiles)


def request_for(kind: Kind, depth: int) -> QoSProfile:
    """Return the request that publishers of a kind meet, whatever else they offer."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth,
        reliability=(
            ReliabilityPolicy.RELIABLE if kind.reliable else ReliabilityPolicy.BEST_EFFORT),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if kind.latched else DurabilityPolicy.VOLATILE))


def offer_for(profiles: Sequence[dict[str, Any]]) -> QoSProfile:
    """
    Return the profile to play a topic with: what was recorded.

    Of several publishers each policy is the strongest, so that whoever heard one of them hears
    the player. Without any it is reliable and volatile.
    """
    profiles = profiles or [offered_qos()]
    kinds = kinds_of(profiles)
    offer = request_for(
        Kind(any(kind.reliable for kind in kinds), any(kind.latched for kind in kinds)),
        PLAY_DEPTH)
    # a promise is the stronger the shorter it is, a life the longer
    offer.deadline = min(_duration(one['deadline']) for one in profiles)
    offer.lifespan = max(_duration(one['lifespan']) for one in profiles)
    offer.liveliness_lease_duration = min(
        _duration(one['liveliness_lease_duration']) for one in profiles)
    offer.liveliness = (
        LivelinessPolicy.MANUAL_BY_TOPIC
        if any(one['liveliness'] == 'manual_by_topic' for one in profiles)
        else LivelinessPolicy.AUTOMATIC)
    return offer


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


def _duration(told: dict[str, int]) -> Duration:
    """Return a duration of a bag; what is none is infinite."""
    nanoseconds = told['sec'] * NANOSECONDS + told['nsec']
    if not 0 < nanoseconds < Infinite.nanoseconds:
        return Infinite
    return Duration(nanoseconds=max(nanoseconds, LEAST_DURATION))
