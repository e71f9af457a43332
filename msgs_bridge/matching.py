# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the graph knows: its names, the ends of a topic, and whether those fit."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import contextlib
from typing import NamedTuple

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


class NamesHidden(Exception):
    """
    rclpy cannot tell the names of the graph.

    Attributes:
        names: name -> types, of the nodes of which it can.
    """

    def __init__(self, reason: Exception, names: Mapping[str, Sequence[str]]) -> None:
        """Carry what could be learned all the same."""
        super().__init__(str(reason))
        self.names = names


def topics_of(node: Node) -> Mapping[str, Sequence[str]]:
    """
    Return name -> types of the topics of the graph; none when ROS is shutting down.

    Raises:
        NamesHidden: one name or type on the wire is no text, so that rclpy tells none.
    """
    return _named(
        node, node.get_topic_names_and_types, node.get_publisher_names_and_types_by_node)


def services_of(node: Node) -> Mapping[str, Sequence[str]]:
    """
    Return name -> types of the services of the graph; none when ROS is shutting down.

    Raises:
        NamesHidden: as `topics_of`.
    """
    return _named(
        node, node.get_service_names_and_types, node.get_service_names_and_types_by_node)


def as_known(
    find: Callable[[Node], Mapping[str, Sequence[str]]], node: Node,
) -> Mapping[str, Sequence[str]]:
    """Return what `topics_of` or `services_of` finds, or that part of it that rclpy tells."""
    try:
        return find(node)
    except NamesHidden as hidden:
        return hidden.names


def nodes_of(node: Node) -> Sequence[tuple[str, str]]:
    """Return name and namespace of the nodes of the graph; none where rclpy cannot tell."""
    with contextlib.suppress(Exception):
        return node.get_node_names_and_namespaces()
    return []


def _named(
    node: Node, find: Callable[[], Sequence[tuple[str, Sequence[str]]]],
    find_by_node: Callable[[str, str], Sequence[tuple[str, Sequence[str]]]],
) -> Mapping[str, Sequence[str]]:
    try:
        return dict(find())
    except Exception as error:
        # a signal may shut ROS down in the middle of any call, and calls differ in what they raise
        if not node.context.ok():
            return {}
        names: dict[str, set[str]] = {}
        for name, space in nodes_of(node):
            with contextlib.suppress(Exception):
                for found, types in find_by_node(name, space):
                    names.setdefault(found, set()).update(types)
        raise NamesHidden(error, {name: sorted(types) for name, types in names.items()}) from None


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


class Misfit(NamedTuple):
    """Two ends of a topic between which nothing flows, and why: 'type' or 'QoS'."""

    kind: str
    publisher: TopicEndpointInfo
    subscription: TopicEndpointInfo
    reason: str


def misfits(
    publishers: Sequence[TopicEndpointInfo], subscriptions: Sequence[TopicEndpointInfo],
) -> Iterator[Misfit]:
    """Yield each pair of ends of a topic that do not match."""
    for publisher in publishers:
        for subscription in subscriptions:
            if publisher.topic_type != subscription.topic_type:
                yield Misfit('type', publisher, subscription,
                             f'{plain(publisher.topic_type, 60)} is published, '
                             f'{plain(subscription.topic_type, 60)} is subscribed to')
            elif reason := _qos_problem(publisher.qos_profile, subscription.qos_profile):
                yield Misfit('QoS', publisher, subscription, reason)


def full_name(end: TopicEndpointInfo) -> str:
    """Return the full name of the node of an end, as it may be shown."""
    return plain(f'{end.node_namespace.rstrip("/")}/{end.node_name}', 100)


def _qos_problem(offered: QoSProfile, asked: QoSProfile) -> str:
    """Return why a publisher and a subscription do not match by their QoS, '' if they do."""
    compatible, reason = qos_check_compatible(_comparable(offered), _comparable(asked))
    return '' if compatible != QoSCompatibility.ERROR else reason.replace(
        'ERROR: ', '').strip('; ')


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
    name = full_name(other)
    if other.topic_type != type_name:
        return f'{name} {theirs} {plain(other.topic_type, 60)}, this node {ours} {type_name}'
    reason = _qos_problem(offered, asked)
    return f'QoS of {name} does not match: {reason}' if reason else None
