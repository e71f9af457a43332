# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Action spaces: what the outputs of a network mean as commands.

Replay, learners, network heads, policies, `q_values` and bags take sizes, types and names from
here. A further kind of space is a class with the methods of `ActionSpace` and a line in `KINDS`;
how a learner finds the values of its actions is said in `trainer_node/action_values.py`.

CarRacing's wheels turn by at most 0.4 rad, so an angular command of 0.4 already asks for full
lock and only smaller ones are gentle.
"""
from __future__ import annotations

import dataclasses
import math
from typing import Any, Protocol

import numpy as np

from dqn_policy_node.action_limits import check_names, check_range, check_text, TOLERANCE
from dqn_policy_node.axis_actions import Continuous, Hybrid, Mode
from dqn_policy_node.errors import ModelError
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command


class ActionSpace(Protocol):
    """
    A kind of actions.

    An *encoded* action is what the replay buffer keeps: an array of `dtype` and `shape`.

    Attributes:
        kind: name of the kind, as in `KINDS`.
        name: name of this space.
        names: name of each output of the network.
        dtype, shape: of an encoded action.
    """

    kind: str
    name: str
    names: tuple[str, ...]
    dtype: np.dtype
    shape: tuple[int, ...]

    def __len__(self) -> int:
        """Return the number of outputs of the network."""

    def encode(self, command: Command) -> Any:
        """Return the encoded action that a command meant; raises MessageError for none."""

    def nearest(self, command: Command) -> Any:
        """Return the encoded action whose command is nearest to a finite one."""

    def decode(self, action: Any) -> Command:
        """Return the command of an encoded action."""

    def greedy(self, values: np.ndarray) -> Any:
        """Return the encoded action of the highest value, values float32 (outputs,)."""

    def explore(self, random: np.random.Generator, gas_weight: float = 1.0) -> Any:
        """Draw an encoded action; one with gas is so much likelier than one without."""

    def chosen(self, action: Any) -> dict[str, float]:
        """Return what `q_values` says of an encoded action: `chosen`, and more where there is."""

    def mirror(self, actions: np.ndarray) -> np.ndarray:
        """Return encoded actions (B, ...) with left and right exchanged; raises ModelError."""

    def to_json(self) -> dict[str, Any]:
        """Return the space as JSON values, `kind` among them."""


@dataclasses.dataclass(frozen=True)
class Discrete:
    """
    A named table of commands; an encoded action is its index.

    Attributes:
        name: name of the space.
        names: name of each action, unique.
        commands: command of each action, in the same order, within [-1, 1].
    """

    name: str
    names: tuple[str, ...]
    commands: tuple[Command, ...]

    kind = 'discrete'
    dtype = np.dtype(np.uint8)
    shape = ()

    def __post_init__(self) -> None:
        """Check the table; raises ModelError."""
        check_names(self.names)
        if len(self.names) != len(self.commands):
            raise ModelError('every action needs a name of its own')
        for name, command in zip(self.names, self.commands):
            check_range(name, command)

    def __len__(self) -> int:
        return len(self.commands)

    def encode(self, command: Command) -> int:
        """
        Return the index of the action that a command meant.

        Raises:
            MessageError: none of the table is within `TOLERANCE` in both numbers.
        """
        distances = self._distances(command)
        distance = min(distances)
        if not distance <= TOLERANCE:
            linear, angular = command
            raise MessageError(
                f'linear {linear:g}, angular {angular:g} is no action of {self.name!r}')
        return distances.index(distance)

    def nearest(self, command: Command) -> int:
        """Return the index of the nearest action, by the larger of both differences."""
        distances = self._distances(command)
        return distances.index(min(distances))

    def _distances(self, command: Command) -> list[float]:
        return [max(abs(given - own) for given, own in zip(command, candidate))
                for candidate in self.commands]

    def decode(self, action: int) -> Command:
        """Return the command of an index."""
        return self.commands[action]

    def greedy(self, values: np.ndarray) -> int:
        """Return the index of the highest value."""
        return int(values.argmax())

    def explore(self, random: np.random.Generator, gas_weight: float = 1.0) -> int:
        """Draw an index; one whose command has gas is so much likelier than one without."""
        if gas_weight == 1:
            return int(random.integers(len(self)))
        weights = np.array([
            gas_weight if command.linear > 0 else 1.0 for command in self.commands])
        return int(np.searchsorted(
            np.cumsum(weights) / weights.sum(), random.random(), side='right'))

    def chosen(self, action: int) -> dict[str, float]:
        """Return what `q_values` says of an index."""
        return {'chosen': action}

    def mirror(self, actions: np.ndarray) -> np.ndarray:
        """
        Return for each index that of the action that turns the other way.

        Raises:
            ModelError: the table is not symmetric.
        """
        try:
            mirrored = [self.encode(Command(linear, -angular)) for linear, angular in
                        self.commands]
        except MessageError as error:
            raise ModelError(f'the action space cannot be mirrored: {error}') from None
        return np.array(mirrored, actions.dtype)[actions]

    def to_json(self) -> dict[str, Any]:
        """Return the space as JSON values."""
        return {
            'kind': self.kind, 'name': self.name,
            'actions': [
                {'name': name, 'linear': command.linear, 'angular': command.angular}
                for name, command in zip(self.names, self.commands)],
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Discrete:
        """Read what `to_json` gives; raises ModelError."""
        try:
            rows = values['actions']
            names = tuple(row['name'] for row in rows)
            commands = tuple(
                Command(*(float(row[key]) for key in Command._fields)) for row in rows)
            name = values['name']
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise ModelError(f'action space: {type(error).__name__} {error}') from None
        check_text(name, *names)
        if not all(math.isfinite(value) for command in commands for value in command):
            raise ModelError('action space: values must be finite')
        return cls(name, names, commands)


KINDS = {kind.kind: kind for kind in (Discrete, Continuous, Hybrid)}


def read_action_space(values: Any) -> ActionSpace:
    """Read what `to_json` of any kind gives, from a source that is not trusted: ModelError."""
    kind = values.get('kind') if isinstance(values, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise ModelError(f'action space of kind {kind!r}; accepted: {", ".join(KINDS)}')
    return KINDS[kind].from_json(values)


def _make(name: str, *rows: tuple[str, float, float]) -> Discrete:
    return Discrete(
        name, tuple(row[0] for row in rows), tuple(Command(*row[1:]) for row in rows))


# finer where CarRacing's wheels are not yet at full lock; the brakes of the document lock them
LINEAR_NODES = (-0.8, -0.4, -0.2, 0.0, 0.2, 0.5, 1.0)
ANGULAR_NODES = (-1.0, -0.4, -0.2, -0.1, 0.0, 0.1, 0.2, 0.4, 1.0)
# beside a table no node may be one of its commands: what is driven there would teach the table
_ANY = Mode('any', (-0.7, -0.3, -0.1, 0.1, 0.3, 0.6, 0.9), ANGULAR_NODES)


def _beside_any(name: str, discrete: Discrete) -> Hybrid:
    """Return the space of a table's commands and, as one more mode, any command."""
    return Hybrid(name, (*(
        Mode(own, (command.linear,), (command.angular,))
        for own, command in zip(discrete.names, discrete.commands)), _ANY))


# three ways to steer x gas, coast and a light brake
_GRID9 = (
    ('left gas', 0.2, 0.3),
    ('gas', 1.0, 0.0),
    ('right gas', 0.2, -0.3),
    ('left', 0.0, 1.0),
    ('none', 0.0, 0.0),
    ('right', 0.0, -1.0),
    ('left brake', -0.2, 0.3),
    ('brake', -0.4, 0.0),
    ('right brake', -0.2, -0.3),
)

ACTION_SPACES: dict[str, ActionSpace] = {
    space.name: space for space in (
        # the report, section 2.2.2
        _make(
            'seed5',
            ('none', 0.0, 0.0),
            ('left', 0.0, 1.0),
            ('right', 0.0, -1.0),
            ('gas', 1.0, 0.0),
            ('brake', -0.8, 0.0),
        ),
        # gentle gas in bends, a light brake that does not lock the wheels
        _make(
            'gentle7',
            ('none', 0.0, 0.0),
            ('left', 0.0, 1.0),
            ('right', 0.0, -1.0),
            ('gas', 1.0, 0.0),
            ('brake', -0.4, 0.0),
            ('left gas', 0.2, 0.3),
            ('right gas', 0.2, -0.3),
        ),
        # for what only turns, or keeps its own speed
        _make(
            'steer5',
            ('left', 0.0, 1.0),
            ('gentle left', 0.0, 0.3),
            ('none', 0.0, 0.0),
            ('gentle right', 0.0, -0.3),
            ('right', 0.0, -1.0),
        ),
        _make('grid9', *_GRID9),
        # as grid9, with a quarter of the lock at full gas and a brake that is felt
        _make(
            'grid12', *_GRID9,
            ('gentle left gas', 1.0, 0.1),
            ('gentle right gas', 1.0, -0.1),
            ('hard brake', -0.8, 0.0),
        ),
        # as grid9, with gentle steering beside full lock
        _make(
            'fine11',
            ('left', 0.0, 1.0),
            ('gentle left', 0.0, 0.15),
            ('none', 0.0, 0.0),
            ('gentle right', 0.0, -0.15),
            ('right', 0.0, -1.0),
            ('left gas', 0.2, 0.3),
            ('gas', 1.0, 0.0),
            ('right gas', 0.2, -0.3),
            ('left brake', -0.2, 0.3),
            ('brake', -0.5, 0.0),
            ('right brake', -0.2, -0.3),
        ),
    )
}

ACTION_SPACES |= {
    space.name: space for space in (
        # any command within the axes, their values decoupled (arXiv 2210.12566)
        Continuous('continuous', (Mode('', LINEAR_NODES, ANGULAR_NODES),)),
        # which pedal is a choice, how far the wheel is turned is not (5.2; arXiv 1810.06394)
        Hybrid('hybrid', tuple(
            Mode(name, (linear,), ANGULAR_NODES) for name, linear in (
                ('gas', 1.0), ('gentle gas', 0.2), ('coast', 0.0), ('brake', -0.4)))),
        # a table and any command beside each other, for the tuner (5.2)
        _beside_any('seed5+any', ACTION_SPACES['seed5']),
        _beside_any('grid9+any', ACTION_SPACES['grid9']),
    )
}

# the five actions of the report, which its dummy agent (3.2.3) draws from
DUMMY_SPACE = ACTION_SPACES['seed5']


def action_space(name: str) -> ActionSpace:
    """Return a space by name; raises ModelError for a name that is not there."""
    if name not in ACTION_SPACES:
        raise ModelError(f'action space {name!r}; accepted: {", ".join(ACTION_SPACES)}')
    return ACTION_SPACES[name]


def has_two_parts(space: ActionSpace) -> bool:
    """Return whether a space has both single commands and axes, which a tuner can choose from."""
    return isinstance(space, Hybrid) and len(set(space.single)) == 2
