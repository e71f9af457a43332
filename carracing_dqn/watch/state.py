# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The state that is watched, of a live graph or of a bag; whoever shows it takes `snapshot`."""
from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
import dataclasses
import math
import threading
from typing import Any

import numpy as np

from bags.decode import decode
from carracing_dqn.watch.car import Car, Drive, IMAGE_TYPES, message_of, ROLES, TWIST_TYPES
from carracing_dqn.watch.causes import causes
from carracing_dqn.watch.graph_parts import Node, Topic, TopicEnds
from msgs_bridge.errors import BridgeError
from msgs_bridge.health import LEVELS, read_health
from msgs_bridge.plain_text import plain
from msgs_bridge.topics import DIAGNOSTICS, TOPICS, WEIGHTS

MAX_NODES, MAX_TOPICS, MAX_CARS = 200, 300, 16
# a message on /diagnostics of more bytes is none
MAX_HEALTH_BYTES = 1 << 20
# what topics of ours are called, in whatever namespace
OURS = frozenset(topic.name.rpartition('/')[2] for topic in TOPICS)
# a node that has gone is remembered for so long; seconds
REMEMBERED_SECONDS = 600.0
# plots that are shown until others are chosen, as far as they are there
FIRST_PLOTS = ('episode_return', 'speed', 'episode.return', 'validation.mean', 'reward')
MAX_PLOTS = 6
MAX_NAME = 200
# so long it takes to see a graph that is well; a node may be slow to tell its parameters
LOOK_SECONDS, ASK_SECONDS = 8.0, 60.0

RUNNING, GONE, SILENT, UNKNOWN = 'running', 'gone', 'silent', 'says nothing'
# a node of ours speaks once a second; on a busy machine it may be late
SILENT_SECONDS = 8.0
# a watch that has not looked for so long has itself been held up, and heard nobody
HELD_UP_SECONDS = 2.0


def cars_first(topics: Mapping[str, Collection[str]]) -> list[str]:
    """
    Return names of topics in the order in which they are taken as far as there is room.

    Args:
        topics: name -> types.
    """
    def place(name: str) -> tuple[int, str]:
        if name.rpartition('/')[2] in OURS:
            return 0, name
        return (1 if {*IMAGE_TYPES, *TWIST_TYPES} & set(topics[name]) else 2), name

    return sorted(topics, key=place)


class WatchState:
    """
    Everything that is known at the moment; bounded, whatever comes.

    Every method may be called from any thread.

    Attributes:
        title: what is watched, in words.
        nodes, topics: by full name.
        cars: by namespace.
        parameters: of nodes that were asked, by full name of the node.
        services: what can be called, by full name.
        rejected: messages that could not be used, beside those that a car counts.
        notice: the answer to the last command.
        playing: of a bag: `position`, `duration`, `paused`, `rate`; empty for a live graph.
    """

    def __init__(self, title: str) -> None:
        """Begin with nothing."""
        self.title = title
        self.nodes: dict[str, Node] = {}
        self.topics: dict[str, Topic] = {}
        self.cars: dict[str, Car] = {}
        self.parameters: dict[str, Mapping[str, Any]] = {}
        self.services: frozenset[str] = frozenset()
        self.rejected = 0
        self.notice = ''
        self.playing: dict[str, Any] = {}
        self._roles: dict[str, tuple[Car, str]] = {}
        self._began = math.inf
        self._looked_at = self._held_up_at = -math.inf
        self._lock = threading.RLock()

    # --- from the source

    def see_graph(
        self, nodes: Iterable[str], topics: Mapping[str, TopicEnds], now: float,
        services: Iterable[str] = (),
    ) -> None:
        """Take what the graph consists of now; `now` in s, as everywhere."""
        with self._lock:
            self._began = min(self._began, now)
            for name in nodes:
                node = self._node(name, now, listed=True)
                if node is not None:
                    node.listed_at = now
            for name in [name for name, node in self.nodes.items() if now - max(
                    node.listed_at or node.since, node.heard_at or 0.0) > REMEMBERED_SECONDS]:
                self._drop(name)
            for name in self.topics.keys() - topics.keys():
                del self.topics[name]
            for name, ends in topics.items():
                if name in self.topics:
                    self.topics[name].ends = ends
                elif len(self.topics) < MAX_TOPICS and plain(name, MAX_NAME) == name:
                    # it is shown as it is, and so is the namespace in it; DDS takes any bytes
                    self.topics[name] = Topic(name, ends)
            self.services = frozenset(services)
            self._assign()

    def take(
        self, name: str, type_name: str, data: bytes, now: float, sequence: int = 0,
    ) -> None:
        """Take a message as it came over the wire or stands in a bag."""
        with self._lock:
            topic = self.topics.get(name)
            if topic is None:
                return
            topic.came(now, len(data), sequence)
            if type_name == DIAGNOSTICS.type_name:
                self._hear(data, now)
            elif name in self._roles:
                car, role = self._roles[name]
                car.take(role, message_of(type_name, data, sequence))

    def take_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Keep the parameters of a node."""
        with self._lock:
            if node in self.nodes:
                self.parameters[node] = dict(values)

    def forget(self, *, everything: bool) -> None:
        """Forget what nodes said, because time has jumped; back, then all that came."""
        with self._lock:
            self.nodes, self.parameters = {}, {}
            if everything:
                self.topics, self.cars, self._roles = {}, {}, {}
                self._looked_at = self._held_up_at = -math.inf

    def look(self, now: float) -> None:
        """Decode what is newest; to be called some times a second."""
        with self._lock:
            if now - self._looked_at > HELD_UP_SECONDS:
                self._held_up_at = now
            self._looked_at = now
            for car in self.cars.values():
                car.look(now)

    def say(self, text: str) -> None:
        """Show a line: the answer to a command."""
        self.notice = plain(text, 200)

    # --- for those who show it

    def snapshot(
        self, now: float, namespace: str | None = None, plots: Iterable[str] = (),
    ) -> dict[str, Any]:
        """
        Return what is shown as values that JSON knows, without NaN.

        Args:
            now: in s.
            namespace: of the car to show; None: the first.
            plots: names of the numbers to plot; empty: a choice.
        """
        with self._lock:
            car = self._car(namespace)
            # of the car that is shown first
            ours = '' if car is None else f'{car.namespace}/'
            found = sorted(causes(self, now), key=lambda cause: not cause.where.startswith(ours))
            return {
                'title': self.title, 'notice': self.notice, 'playing': dict(self.playing),
                'cars': sorted(self.cars),
                'causes': [cause._asdict() for cause in found],
                'looking': self._looking(now),
                'nodes': [self._show_node(node, now) for _, node in sorted(self.nodes.items())],
                'topics': [_show_topic(topic, now) for _, topic in sorted(self.topics.items())],
                'rejected': self.rejected + sum(one.rejected for one in self.cars.values()),
                'switches': self._switches(car),
                **_show_car(car, now, list(plots)),
            }

    def drive(self, namespace: str | None = None) -> Drive | None:
        """Return a copy of what is known of a car's drive, None where there is no car."""
        with self._lock:
            car = self._car(namespace)
            return None if car is None else dataclasses.replace(car.drive)

    def pixels(self, namespace: str | None = None) -> np.ndarray | None:
        """Return the picture of a car, uint8 (H, W, 3) rgb, None where there is none."""
        with self._lock:
            car = self._car(namespace)
            return None if car is None else car.drive.pixels

    def node_state(self, node: Node, now: float) -> str:
        """Return whether a node runs, is gone, or has fallen silent."""
        listed = node.listed_at is not None and (
            not self._graph_seen() or node.listed_at >= self._graph_seen() - 0.1)
        spoke = node.heard_at is not None
        fresh = spoke and now - max(node.heard_at, self._held_up_at) < SILENT_SECONDS
        if not listed and not fresh:
            return GONE
        if fresh:
            return RUNNING
        return SILENT if spoke else UNKNOWN

    # --- within

    def _looking(self, now: float) -> bool:
        """Return whether it is too early to say that nothing is wrong."""
        if self.playing:
            return False
        asked = (node for name, node in self.nodes.items()
                 if (node.is_policy or node.is_simulator) and name not in self.parameters)
        heard = any(node.heard_at is not None for node in self.nodes.values())
        return not heard or now - self._began < LOOK_SECONDS or any(
            now - node.since < ASK_SECONDS for node in asked)

    def _graph_seen(self) -> float:
        return max((node.listed_at or 0.0 for node in self.nodes.values()), default=0.0)

    def _switches(self, car: Car | None) -> dict[str, Any]:
        """Return whether the car's simulator is paused, its policy enabled, and its epsilon."""
        found: dict[str, Any] = {'paused': self.playing.get('paused')}
        for name, node in self.nodes.items():
            if car is None or name.rpartition('/')[0] != car.namespace or self.playing:
                continue
            if node.is_simulator:
                found['paused'] = node.values.get('paused') == 'True'
            elif node.is_policy:
                found['enabled'] = node.values.get('enabled') == 'True'
                found['epsilon'] = _number(node.number('epsilon'))
        return found

    def _car(self, namespace: str | None) -> Car | None:
        if namespace in self.cars:
            return self.cars[namespace]
        return self.cars[min(self.cars)] if self.cars else None

    def _node(self, name: str, now: float, *, listed: bool = False) -> Node | None:
        """Return a node, a new one where there is room; one of the graph makes room."""
        if name in self.nodes or not 0 < len(name) <= MAX_NAME:
            return self.nodes.get(name)
        if len(self.nodes) >= MAX_NODES:
            # anybody may say anything of any name on /diagnostics
            others = [one for one in self.nodes.values() if one.listed_at is None]
            if not (listed and others):
                return None
            self._drop(min(others, key=lambda one: one.heard_at or one.since).name)
        self.nodes[name] = Node(name, now)
        return self.nodes[name]

    def _drop(self, name: str) -> None:
        del self.nodes[name]
        self.parameters.pop(name, None)

    def _hear(self, data: bytes, now: float) -> None:
        try:
            if len(data) > MAX_HEALTH_BYTES:
                raise BridgeError('too large')
            told = list(read_health(decode(data, DIAGNOSTICS.type_name, 'diagnostics')))
        except (BridgeError, ValueError, TypeError, AttributeError):
            self.rejected += 1
            return
        for said in told:
            node = self._node(said.node, now)
            if node is None:
                continue
            node.hear(said, now)
            space = said.node.rpartition('/')[0]
            if space in self.cars:
                self.cars[space].hear(node, now)
            if node.is_trainer:
                # one learns from many cars
                for car in self.cars.values():
                    if self._teaches(node.name, car.namespace):
                        car.hand_out(node.number('weights_version'), now)

    def _teaches(self, trainer: str, space: str) -> bool:
        """Return whether a car is in a trainer's namespace or below, or hears its weights."""
        return f'{space}/'.startswith(f'{trainer.rpartition("/")[0]}/') or any(
            trainer in {end.node for end in topic.ends.publishers}
            and space in {end.node.rpartition('/')[0] for end in topic.ends.subscriptions}
            for topic in self.topics.values() if topic.ends.type_name == WEIGHTS.type_name)

    def _assign(self) -> None:
        """Say which topic is what to which car."""
        published = {name: topic for name, topic in self.topics.items()
                     if topic.ends.publishers}
        spaces = {name.rpartition('/')[0] for name in published
                  if name.rpartition('/')[2] in ROLES}
        images = [name for name, topic in published.items()
                  if topic.ends.type_name in IMAGE_TYPES]
        if not spaces and images:
            spaces = {''}
        for space in sorted(spaces - self.cars.keys()):
            if len(self.cars) >= MAX_CARS:
                # those that have gone make room
                gone = sorted(self.cars.keys() - spaces)
                if not gone:
                    break
                self.rejected += self.cars.pop(gone[0]).rejected
            self.cars[space] = Car(space)
        self._roles = {}
        for space, car in self.cars.items():
            for role in ROLES:
                self._roles[f'{space}/{role}'] = (car, role)
        # whose camera or twists are called otherwise
        for role, names in (('image_raw', images), ('cmd_vel', [
                name for name, topic in published.items()
                if topic.ends.type_name in TWIST_TYPES])):
            for space, car in self.cars.items():
                if f'{space}/{role}' in published:
                    continue
                for name in sorted(names):
                    if name not in self._roles and name.startswith(f'{space}/'):
                        self._roles[name] = (car, role)
                        break

    def role_of(self, name: str) -> str:
        """Return what a topic is to a car, '' for none."""
        return self._roles[name][1] if name in self._roles else ''

    def _show_node(self, node: Node, now: float) -> dict[str, Any]:
        return {
            'name': node.name, 'state': self.node_state(node, now),
            'level': LEVELS[node.level] if node.heard_at is not None else '',
            'summary': node.summary, 'values': dict(node.values),
            'age': None if node.heard_at is None else _number(now - node.heard_at)}


def _show_topic(topic: Topic, now: float) -> dict[str, Any]:
    ends = topic.ends
    return {
        'name': topic.name, 'type': ends.type_name, 'rate': _number(topic.rate(now)),
        'age': None if topic.heard_at is None else _number(now - topic.heard_at),
        'bytes': topic.size,
        'publishers': [one._asdict() for one in ends.publishers],
        'subscriptions': [one._asdict() for one in ends.subscriptions],
        'misfits': [one._asdict() for one in ends.misfits]}


def _show_car(car: Car | None, now: float, plots: list[str]) -> dict[str, Any]:
    if car is None:
        return {'namespace': None, 'picture': None, 'drive': {}, 'series': [], 'plots': {}}
    drive, names = car.drive, car.series.names
    wanted = [name for name in plots if name in names] or [
        name for name in FIRST_PLOTS if name in names]
    step = drive.step
    return {
        'namespace': car.namespace,
        'picture': None if drive.pixels is None else {
            'number': car.number, 'stamp': drive.stamp / 1e9, 'encoding': plain(drive.encoding),
            'width': drive.size[0], 'height': drive.size[1]},
        'drive': {
            **{name: _number(step.get(name)) for name in (
                'episode', 'decision', 'reward', 'episode_return', 'speed', 'tiles_visited',
                'tiles_total')},
            'actions': [[plain(name, 40), _number(value)] for name, value in drive.actions],
            'chosen': drive.chosen, 'explored': drive.explored,
            'version': _number(drive.version),
            'linear': None if drive.command is None else _number(drive.command.linear),
            'angular': None if drive.command is None else _number(drive.command.angular),
            'validation': _number(drive.validation.get('mean')),
            'ended': drive.ended},
        'series': names,
        'plots': {name: [[round(ago, 2), _number(value)] for ago, value in points]
                  for name in wanted[:MAX_PLOTS] if (points := car.series.points(name, now))},
    }


def _number(value: float | None) -> float | None:
    """Return a number that JSON can carry in few characters, None in place of NaN."""
    if value is None or not math.isfinite(value):
        return None
    return float(f'{value:.6g}')
