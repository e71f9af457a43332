# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the graph says about itself, gathered for the display."""
from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import dataclasses
from typing import Any

from carracing_dqn.bringup.curve import Curve
from carracing_dqn.bringup.graph import KINDS, TRAINER
from msgs_bridge import topics
from msgs_bridge.errors import MessageError
from msgs_bridge.health import read_health
from msgs_bridge.listening_node import absolute_namespace, ListeningNode
from msgs_bridge.message_types import message_class
from msgs_bridge.named_values import read_named_values
from msgs_bridge.qos import qos_profile
from msgs_bridge.step import EPISODE_CORE, VALIDATION_FIELDS

__all__ = ['absolute_namespace', 'GraphState', 'Monitor']

# What is kept, whoever publishes it: everything here has a bound.
KEPT_RESULTS = 100
MAX_CARS = 128

NODES = frozenset(kind.name for kind in KINDS)
SUMMARY = 'summary'
"""Key of a node's summary among its diagnostics values."""


@dataclasses.dataclass
class GraphState:
    """
    The newest word of every node of ours in one namespace, and of the cars that its trainer has.

    Attributes:
        namespace: absolute, without a slash at its end: '' is the root.
        episodes: the newest episodes that have ended, oldest first.
        ended: how many episodes have ended.
        return_sum: sum of their returns.
        validations: the newest results of validation, oldest first.
        health: diagnostics values by full node name, the summary among them.
        cars: what the trainer says of each of several cars, by its namespace.
        curve: mean return of the trainer's last episodes over the wall seconds of its run.
        rejected: messages that could not be used.
    """

    namespace: str = ''
    episodes: deque = dataclasses.field(default_factory=lambda: deque(maxlen=KEPT_RESULTS))
    ended: int = 0
    return_sum: float = 0.0
    validations: deque = dataclasses.field(default_factory=lambda: deque(maxlen=KEPT_RESULTS))
    health: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    cars: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    curve: Curve = dataclasses.field(default_factory=Curve)
    rejected: int = 0

    def value(
        self, node: str, name: str, default: float = float('nan'), *, space: str | None = None,
    ) -> float:
        """Return one number from the diagnostics of a node of this namespace, or of another."""
        space = self.namespace if space is None else space
        return number(self.health.get(f'{space}/{node}', {}), name, default)

    def summary(self, node: str) -> str:
        """Return what a node of this namespace says it is doing; 'starting' before it does."""
        return self.health.get(f'{self.namespace}/{node}', {}).get(SUMMARY, 'starting')

    @property
    def mean_return(self) -> float:
        """Return the mean return of all episodes; NaN without any."""
        return self.return_sum / self.ended if self.ended else float('nan')

    def take_episode(self, message: Any) -> None:
        """Keep the summary of an episode that has ended; raises MessageError."""
        episode = read_named_values(message, EPISODE_CORE)
        if episode['terminated'] or episode['truncated']:
            self.ended += 1
            self.return_sum += episode['episode_return']
            self.episodes.append(episode)

    def take_validation(self, message: Any) -> None:
        """Keep a result of validation; raises MessageError."""
        self.validations.append(read_named_values(message, VALIDATION_FIELDS))

    def take_diagnostics(self, message: Any) -> None:
        """Keep what our nodes of this namespace say; others share the topic."""
        said = list(read_health(message))
        trainer, cars = f'{self.namespace}/{TRAINER.name}', {}
        for one in said:
            # parts of a node follow its name
            full_name, _, part = one.node.partition(': ')
            space, _, node = full_name.rpartition('/')
            if node not in NODES or (space != self.namespace and space not in self.cars):
                continue
            values = {SUMMARY: one.summary, **one.values}
            if not part:
                self.health[full_name] = values
            elif full_name == trainer and len(cars) < MAX_CARS:
                cars[part] = values
        if any(one.node == trainer for one in said):
            self._take_cars(cars)
            self.curve.add(*(self.value(TRAINER.name, name)
                             for name in ('wall_seconds', 'mean_return')))

    def _take_cars(self, cars: dict[str, dict[str, str]]) -> None:
        for name in self.cars.keys() - cars.keys():
            # what a car says of itself is kept as long as the trainer has it
            for node in NODES:
                self.health.pop(f'{name}/{node}', None)
        self.cars = cars


def number(values: Mapping[str, str], name: str, default: float = float('nan')) -> float:
    """Return one number from the diagnostics values of a node or of a part of one."""
    try:
        return float(values[name])
    except (KeyError, ValueError):
        return default


class Monitor(ListeningNode):
    """Hears what the nodes of one namespace say of themselves."""

    def __init__(self, namespace: str = '') -> None:
        """
        Join the graph and listen; signals stay with the caller.

        Raises:
            BridgeError: the namespace is none.
        """
        self.state = GraphState(absolute_namespace(namespace))
        super().__init__('carracing_monitor', self.state.namespace)
        for topic, take in (
            (topics.EPISODE, self.state.take_episode),
            (topics.VALIDATION, self.state.take_validation),
            (topics.DIAGNOSTICS, self.state.take_diagnostics),
        ):
            # deep, because a reader of small depth may hear nothing any more after a flood
            self._node.create_subscription(
                message_class(topic.type_name), topic.name, self._checked(take),
                qos_profile(topic, depth=topics.BURST_DEPTH))
        self.start()

    def simulators(self, space: str = '') -> int:
        """Return how many simulators publish images in this namespace, or in one below it."""
        return self._node.count_publishers('/'.join(filter(None, (space, topics.IMAGE.name))))

    def publishers(self, topic: str) -> int:
        """Return how many publish a topic, by its absolute name."""
        return self._node.count_publishers(topic)

    def _checked(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def callback(message: Any) -> None:
            try:
                take(message)
            except MessageError:
                self.state.rejected += 1

        return callback
