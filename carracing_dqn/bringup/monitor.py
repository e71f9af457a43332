# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the graph says about itself, gathered for the display."""
from __future__ import annotations

from collections import deque
import dataclasses
import threading

from msgs_bridge import topics
from msgs_bridge.host_only import stay_on_this_host
from msgs_bridge.message_types import message_class
from msgs_bridge.named_values import read_named_values
from msgs_bridge.qos import qos_profile
from msgs_bridge.step import EPISODE_CORE, VALIDATION_FIELDS
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

MOVING_AVERAGE = 20
"""Episodes in the moving average of the display."""


@dataclasses.dataclass
class GraphState:
    """
    The newest word of every node.

    Attributes:
        episodes: summaries of the episodes seen, oldest first.
        validations: results of validation, oldest first.
        health: diagnostics values by node name (without namespace).
    """

    episodes: deque = dataclasses.field(default_factory=lambda: deque(maxlen=1000))
    validations: deque = dataclasses.field(default_factory=lambda: deque(maxlen=1000))
    health: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)

    def value(self, node: str, name: str, default: float = float('nan')) -> float:
        """Return one number from a node's diagnostics."""
        try:
            return float(self.health[node][name])
        except (KeyError, ValueError):
            return default

    @property
    def moving_average(self) -> float:
        """Return the mean return of the newest episodes; NaN without any."""
        returns = [episode['episode_return'] for episode in self.episodes][-MOVING_AVERAGE:]
        return sum(returns) / len(returns) if returns else float('nan')


class Monitor:
    """A small node in a thread of its own that only listens."""

    def __init__(self, namespace: str = '') -> None:
        """Join the graph; signals stay with the caller."""
        stay_on_this_host()
        self.state = GraphState()
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(
            'carracing_monitor', context=self._context, namespace=namespace or None,
            start_parameter_services=False, enable_rosout=False, use_global_arguments=False)
        for topic, callback in (
            (topics.EPISODE, self._on_episode),
            (topics.VALIDATION, self._on_validation),
            (topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            self._node.create_subscription(
                message_class(topic.type_name), topic.name, callback, qos_profile(topic))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def simulators(self) -> int:
        """Return how many simulators publish images in this namespace."""
        return self._node.count_publishers(topics.IMAGE.name)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=0.5)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)
        self._thread.join(timeout=1.0)

    def _on_episode(self, message: object) -> None:
        episode = read_named_values(message, EPISODE_CORE)
        if episode['terminated'] or episode['truncated']:
            self.state.episodes.append(episode)

    def _on_validation(self, message: object) -> None:
        self.state.validations.append(read_named_values(message, VALIDATION_FIELDS))

    def _on_diagnostics(self, message: object) -> None:
        for status in message.status:
            name = status.name.rsplit('/', 1)[-1]
            self.state.health[name] = {
                'summary': status.message, **{pair.key: pair.value for pair in status.values}}
