# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Who hears what a player publishes, and who would like to but cannot."""
from __future__ import annotations

from collections.abc import Mapping

from msgs_bridge.matching import deaf_subscriptions, subscriptions_of, type_name_of
from rclpy.node import Node
from rclpy.publisher import Publisher


class Listeners:
    """
    Watches the subscribers of some publishers.

    Attributes:
        mismatches: topics with a subscriber that hears nothing, each with the reason.
    """

    def __init__(self, node: Node, outputs: Mapping[str, Publisher]) -> None:
        """Watch the publishers of a node."""
        self._node = node
        self._outputs = outputs
        self._heard: set[str] = set()
        self._said: set[str] = set()
        self.mismatches: list[str] = []

    @property
    def never_heard(self) -> list[str]:
        """Return the topics that nobody listened to."""
        return sorted(self._outputs.keys() - self._heard)

    def complete(self) -> bool:
        """Return whether each topic reaches a subscriber, and all of whom discovery knows."""
        return all(
            publisher.get_subscription_count() >= max(
                1, self._node.count_subscribers(publisher.topic_name))
            for publisher in self._outputs.values())

    def look(self) -> None:
        """Note who listens, and say once what keeps a subscriber from it."""
        mismatches = []
        for name, publisher in self._outputs.items():
            reached = publisher.get_subscription_count()
            if reached:
                self._heard.add(name)
            if self._node.count_subscribers(publisher.topic_name) > reached:
                mismatches += self._deaf(publisher)
        self.mismatches = mismatches
        for text in mismatches:
            if text not in self._said and len(self._said) < len(self._outputs):
                self._said.add(text)
                self._node.get_logger().warn(text)

    def _deaf(self, publisher: Publisher) -> list[str]:
        """Return who hears nothing of a topic and why, at most one of them."""
        topic = publisher.topic_name
        deaf = deaf_subscriptions(
            subscriptions_of(self._node, topic), type_name_of(publisher.msg_type),
            publisher.qos_profile)
        return [f'{topic} is not heard: {reason}; see the parameters '
                f'qos_overrides.{topic}.publisher.*' for reason in deaf[:1]]
