# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Who hears what a player publishes, and who would like to but cannot."""
from __future__ import annotations

from collections.abc import Mapping

from bags.interim import plain
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_check_compatible, QoSCompatibility


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
                mismatches += self._reasons(publisher)
        self.mismatches = mismatches
        for text in mismatches:
            if text not in self._said and len(self._said) < len(self._outputs):
                self._said.add(text)
                self._node.get_logger().warn(text)

    def _reasons(self, publisher: Publisher) -> list[str]:
        reasons = []
        for one in self._node.get_subscriptions_info_by_topic(publisher.topic_name):
            fits, reason = qos_check_compatible(publisher.qos_profile, one.qos_profile)
            if fits == QoSCompatibility.ERROR:
                reasons.append(
                    f'{one.node_name} does not hear {publisher.topic_name}: {plain(reason)}; '
                    f'see the parameters qos_overrides.{publisher.topic_name}.publisher.*')
        return reasons[:1]
