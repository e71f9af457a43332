# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Whether publishers and subscriptions of one topic fit, as the graph knows them."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from msgs_bridge.plain_text import plain
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

# what discovery reports in place of no deadline at all, in ns; it differs between versions
ENDLESS = 2**62


def type_name_of(message_class: type) -> str:
    """Return `package/msg/Type` of a message class, as the graph names it."""
    return f'{message_class.__module__.split(".")[0]}/msg/{message_class.__name__}'


def publishers_of(node: Node, name: str) -> Sequence[TopicEndpointInfo]:
    """Return the publishers of a topic by its full name; none where rclpy cannot tell."""
    return _ends(node, node.get_publishers_info_by_topic, name)


def subscriptions_of(node: Node, name: str) -> Sequence[TopicEndpointInfo]:
    """Return the subscriptions of a topic by its full name; none where rclpy cannot tell."""
    return _ends(node, node.get_subscriptions_info_by_topic, name)


def _ends(
    node: Node, find: Callable[[str], Sequence[TopicEndpointInfo]], name: str,
) -> Sequence[TopicEndpointInfo]:
    try:
        return find(name)
    except Exception:
        # a signal may shut ROS down in the middle of any call, and calls differ in what they
        # raise then; and where the type of one end is no text, rclpy tells of none of them
        return []


def common_request(
    publishers: Sequence[TopicEndpointInfo], *, latched: bool,
) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    """
    Return the strongest reliability and durability that every publisher meets.

    Args:
        publishers: those of the topic that publish the type wanted; none are met by anything.
        latched: whether the topic's last messages are wanted, too, where all keep them.
    """
    offered = [publisher.qos_profile for publisher in publishers]
    reliable = all(one.reliability != ReliabilityPolicy.BEST_EFFORT for one in offered)
    kept = latched and all(one.durability != DurabilityPolicy.VOLATILE for one in offered)
    return (ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE)


def unheard_publishers(
    publishers: Iterable[TopicEndpointInfo], type_name: str, asked: QoSProfile,
) -> list[str]:
    """Return a text for each publisher from which a subscription gets nothing."""
    return [text for publisher in publishers if (text := _misfit(
        publisher, type_name, 'publishes', 'takes', publisher.qos_profile, asked))]


def deaf_subscriptions(
    subscriptions: Iterable[TopicEndpointInfo], type_name: str, offered: QoSProfile,
) -> list[str]:
    """Return a text for each subscription that gets nothing from a publisher."""
    return [text for subscription in subscriptions if (text := _misfit(
        subscription, type_name, 'takes', 'publishes', offered, subscription.qos_profile))]


def _comparable(qos: QoSProfile) -> QoSProfile:
    """Return a profile in which endless durations are unset, for both ways of writing them."""
    return QoSProfile(
        depth=1, reliability=qos.reliability, durability=qos.durability,
        liveliness=qos.liveliness, deadline=_bounded(qos.deadline),
        liveliness_lease_duration=_bounded(qos.liveliness_lease_duration))


def _bounded(duration: Duration) -> Duration:
    return duration if duration.nanoseconds < ENDLESS else Duration()


def _misfit(
    other: TopicEndpointInfo, type_name: str, theirs: str, ours: str,
    offered: QoSProfile, asked: QoSProfile,
) -> str | None:
    name = plain(f'{other.node_namespace.rstrip("/")}/{other.node_name}', 60)
    if other.topic_type != type_name:
        return f'{name} {theirs} {plain(other.topic_type, 60)}, this node {ours} {type_name}'
    compatible, reason = qos_check_compatible(_comparable(offered), _comparable(asked))
    if compatible != QoSCompatibility.ERROR:
        return None
    return f'QoS of {name} does not match: {reason.replace("ERROR: ", "").strip("; ")}'
