# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the graph, also while somebody announces a name that is no text."""
from __future__ import annotations

import contextlib

from rclpy.node import Node


class NamesHidden(Exception):
    """rclpy cannot tell the names of the graph; `names` are those of the nodes it can tell."""

    def __init__(self, reason: Exception, names: set[str]) -> None:
        """Carry what could be learned all the same."""
        super().__init__(str(reason))
        self.names = names


def topic_names(node: Node) -> set[str]:
    """
    Return the topics of the graph; none when ROS is shutting down.

    Raises:
        NamesHidden: one name or type on the wire is no text, so that rclpy tells none.
    """
    try:
        return {name for name, _ in node.get_topic_names_and_types()}
    except Exception as error:
        # a signal may shut ROS down in the middle of any call, and calls differ in what they raise
        if not node.context.ok():
            return set()
        raise NamesHidden(error, _names_by_node(node)) from None


def _names_by_node(node: Node) -> set[str]:
    """Return the topics of the nodes whose topics can be read."""
    names: set[str] = set()
    with contextlib.suppress(Exception):
        for name, space in node.get_node_names_and_namespaces():
            with contextlib.suppress(Exception):
                names.update(topic for topic, _ in
                             node.get_publisher_names_and_types_by_node(name, space))
    return names
