# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Continuous actions that a Q-network can rank: values of nodes along axes, decoupled.

Each axis of a command has an output at each of its nodes, and a value in between is a straight
line from node to node. The value of an action is the mean of its axes' (arXiv 2210.12566), so the
best action is the best node of every axis, found without an optimizer, and every command within
the axes has a value, whoever drove it.

A *hybrid* space has several modes, some of which may be single commands: a discrete choice, and
what goes on within it (arXiv 1810.06394, with nodes in place of an actor). The best action is the
best mode at its own best nodes.
"""
from __future__ import annotations

import bisect
import dataclasses
from typing import Any

import numpy as np

from dqn_policy_node.action_limits import check_names, check_range, check_text, TOLERANCE
from dqn_policy_node.errors import ModelError
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command

AXES = Command._fields
NONE = -1.0
"""Place on an axis that a mode does not have."""


@dataclasses.dataclass(frozen=True)
class Mode:
    """
    One of the choices: both numbers of the command, each fixed or along an axis.

    Attributes:
        name: in front of the names of its outputs; may be empty where there is one mode.
        linear, angular: one value that is fixed, or the rising nodes of an axis.
    """

    name: str
    linear: tuple[float, ...]
    angular: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the nodes; raises ModelError."""
        for nodes in (self.linear, self.angular):
            if not nodes:
                raise ModelError(f'mode {self.name!r} has an axis without a node')
            check_range(self.name, nodes)
            if any(not low + TOLERANCE < high for low, high in zip(nodes, nodes[1:])):
                raise ModelError(f'nodes of mode {self.name!r} are {nodes}; accepted: rising, '
                                 f'more than {TOLERANCE} apart')

    @property
    def nodes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the values of linear and of angular."""
        return self.linear, self.angular

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the names of its outputs: a node each, or itself where nothing is an axis."""
        names = [
            f'{self.name} {axis} {node:g}'.strip()
            for axis, nodes in zip(AXES, self.nodes) if len(nodes) > 1 for node in nodes]
        return tuple(names) or (self.name,)


@dataclasses.dataclass(frozen=True)
class Hybrid:
    """
    Modes, each with its own axes or none.

    An encoded action is the place among the outputs, float32 (2,), for each axis of its mode in
    order: 3.25 is a quarter of the way from output 3 to output 4. A place that the mode has no
    axis for is `NONE`; a mode without any is the place of its one output.

    Attributes:
        name: name of the space.
        modes: the choices. A command that fits several is taken for the first of them.
    """

    name: str
    modes: tuple[Mode, ...]

    kind = 'hybrid'
    dtype = np.dtype(np.float32)
    shape = (2,)

    def __post_init__(self) -> None:
        """Check the modes and lay their outputs out; raises ModelError."""
        check_names(self.names)
        layout, first = [], 0
        for mode in self.modes:
            sizes = [len(nodes) for nodes in mode.nodes if len(nodes) > 1] or [1]
            starts = np.cumsum([first, *sizes])
            layout.append(tuple(slice(int(low), int(high))
                                for low, high in zip(starts, starts[1:])))
            first = int(starts[-1])
        object.__setattr__(self, '_layout', tuple(layout))
        object.__setattr__(self, '_firsts', [axes[0].start for axes in layout])

    @property
    def names(self) -> tuple[str, ...]:
        """Return the name of each output."""
        return tuple(name for mode in self.modes for name in mode.outputs)

    @property
    def layout(self) -> tuple[tuple[slice, ...], ...]:
        """Return for each mode the outputs of each of its axes; of one without, its one."""
        return self._layout

    @property
    def single(self) -> tuple[bool, ...]:
        """Return for each mode whether it is a single command."""
        return tuple(max(map(len, mode.nodes)) == 1 for mode in self.modes)

    def part(self, *, axes: bool) -> tuple[int, ...]:
        """Return the numbers of the modes that have axes, or of those that are commands."""
        return tuple(number for number, single in enumerate(self.single) if single != axes)

    def __len__(self) -> int:
        return self._layout[-1][-1].stop

    def mode(self, action: np.ndarray) -> int:
        """Return the number of the mode of an encoded action."""
        return bisect.bisect_right(self._firsts, float(action[0])) - 1

    def encode(self, command: Command) -> np.ndarray:
        """
        Return the places that a command meant, float32 (2,).

        Raises:
            MessageError: it is further than `TOLERANCE` from every mode.
        """
        for mode, axes in zip(self.modes, self._layout):
            if all(nodes[0] - TOLERANCE <= given <= nodes[-1] + TOLERANCE
                   for given, nodes in zip(command, mode.nodes)):
                places = [
                    float(np.interp(given, nodes, range(len(nodes))))
                    for given, nodes in zip(command, mode.nodes) if len(nodes) > 1] or [0.0]
                return self._action([
                    axis.start + place for axis, place in zip(axes, places)])
        linear, angular = command
        raise MessageError(
            f'linear {linear:g}, angular {angular:g} is no action of {self.name!r}')

    def nearest(self, command: Command) -> np.ndarray:
        """Return the places of the nearest command that there is, float32 (2,)."""
        held = [Command(*(min(max(given, nodes[0]), nodes[-1])
                          for given, nodes in zip(command, mode.nodes))) for mode in self.modes]
        return self.encode(min(held, key=lambda own: max(
            abs(given - kept) for given, kept in zip(command, own))))

    def _action(self, places: list[float]) -> np.ndarray:
        return np.array([*places, NONE][:2], np.float32)

    def decode(self, action: np.ndarray) -> Command:
        """Return the command of an encoded action."""
        number = self.mode(action)
        places = iter(zip(self._layout[number], action))
        values = []
        for nodes in self.modes[number].nodes:
            if len(nodes) == 1:
                values.append(nodes[0])
                continue
            axis, place = next(places)
            values.append(float(np.interp(
                float(place) - axis.start, range(len(nodes)), nodes)))
        return Command(*values)

    def greedy(self, values: np.ndarray, modes: tuple[int, ...] | None = None) -> np.ndarray:
        """
        Return the best mode at its best nodes, float32 (2,).

        Args:
            values: of the outputs, float32 (outputs,).
            modes: numbers of those to choose from; None for all.
        """
        numbers = range(len(self.modes)) if modes is None else modes
        best = max(numbers, key=lambda number: sum(
            values[axis].max() for axis in self._layout[number]) / len(self._layout[number]))
        return self._action([
            float(axis.start + values[axis].argmax()) for axis in self._layout[best]])

    def explore(
        self, random: np.random.Generator, gas_weight: float = 1.0,
        modes: tuple[int, ...] | None = None,
    ) -> np.ndarray:
        """
        Draw a mode, and places uniformly along its axes: more often where nodes lie close.

        Args:
            random: what is drawn from.
            gas_weight: how much likelier what has gas is than what has none.
            modes: numbers of those to draw from; None for all.
        """
        numbers = list(range(len(self.modes)) if modes is None else modes)
        weights = np.array([
            gas_weight if self.modes[number].linear[0] > 0 else 1.0 for number in numbers])
        number = numbers[int(np.searchsorted(
            np.cumsum(weights) / weights.sum(), random.random(), side='right'))]
        places = []
        for axis, nodes in zip(self._layout[number], (
                nodes for nodes in self.modes[number].nodes if len(nodes) > 1)):
            last = len(nodes) - 1
            place = random.random() * last
            if nodes is self.modes[number].linear and nodes[0] < 0 < nodes[-1]:
                place = _weighted(random, float(np.interp(0.0, nodes, range(len(nodes)))), last,
                                  gas_weight)
            places.append(axis.start + place)
        return self._action(places or [float(self._layout[number][0].start)])

    def chosen(self, action: np.ndarray) -> dict[str, float]:
        """Return what `q_values` says of an encoded action: the nearest output of each axis."""
        first, second = (round(float(place)) for place in action)
        return {'chosen': first, 'chosen_second': second}

    def mirror(self, actions: np.ndarray) -> np.ndarray:
        """
        Return encoded actions, float32 (B, 2), with left and right exchanged.

        Raises:
            ModelError: the modes are not symmetric.
        """
        mirrored = actions.copy()
        for row, action in enumerate(actions):
            linear, angular = self.decode(action)
            try:
                mirrored[row] = self.encode(Command(linear, -angular))
            except MessageError as error:
                raise ModelError(f'the action space cannot be mirrored: {error}') from None
        return mirrored

    def to_json(self) -> dict[str, Any]:
        """Return the space as JSON values."""
        return {'kind': self.kind, 'name': self.name, 'modes': [
            {'name': mode.name, **{axis: list(nodes) for axis, nodes in zip(AXES, mode.nodes)}}
            for mode in self.modes]}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Hybrid:
        """Read what `to_json` gives; raises ModelError."""
        try:
            name, rows = values['name'], values['modes']
            modes = tuple(Mode(row['name'], *(_nodes(row[axis]) for axis in AXES))
                          for row in rows)
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            if isinstance(error, ModelError):
                raise
            raise ModelError(f'action space: {type(error).__name__} {error}') from None
        check_text(name, *(mode.name for mode in modes))
        return cls(name, modes)


@dataclasses.dataclass(frozen=True)
class Continuous(Hybrid):
    """One mode of two axes: any command within them."""

    kind = 'continuous'

    def __post_init__(self) -> None:
        """Check that it is one mode of two axes; raises ModelError."""
        if len(self.modes) != 1 or min(map(len, self.modes[0].nodes)) < 2:
            raise ModelError('a continuous space has nodes along linear and along angular')
        super().__post_init__()

    def to_json(self) -> dict[str, Any]:
        """Return the space as JSON values."""
        return {'kind': self.kind, 'name': self.name, **{
            axis: list(nodes) for axis, nodes in zip(AXES, self.modes[0].nodes)}}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Continuous:
        """Read what `to_json` gives; raises ModelError."""
        try:
            name, nodes = values['name'], [_nodes(values[axis]) for axis in AXES]
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise ModelError(f'action space: {type(error).__name__} {error}') from None
        check_text(name)
        return cls(name, (Mode('', *nodes),))


def _nodes(values: Any) -> tuple[float, ...]:
    """Return nodes from a list of numbers; TypeError or ValueError if it is none."""
    if not isinstance(values, list):
        raise TypeError(f'nodes are a {type(values).__name__}, not a list')
    return tuple(float(value) for value in values)


def _weighted(
    random: np.random.Generator, middle: float, last: float, weight: float,
) -> float:
    """Draw a place from 0 to `last`, those after `middle` so much likelier than those before."""
    above = weight * (last - middle)
    if random.random() * (middle + above) < middle:
        return random.random() * middle
    return middle + random.random() * (last - middle)
