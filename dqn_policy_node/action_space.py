# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Action spaces: what the outputs of a network mean as commands.

Replay, learners, network heads, policies, `q_values` and bags take sizes, types and names from
here. A further kind of space is a class with the methods of `ActionSpace` and a line in `KINDS`.

CarRacing's wheels turn by at most 0.4 rad, so an angular command of 0.4 already asks for full
lock and only smaller ones are gentle.
"""
from __future__ import annotations

import dataclasses
import math
from typing import Any, Protocol

import numpy as np

from dqn_policy_node.errors import ModelError
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command

MAX_ACTIONS = 64
# a twist that went through float32 is off by less than 1e-7; neighbours differ by 0.05 or more
TOLERANCE = 0.01


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

    def decode(self, action: Any) -> Command:
        """Return the command of an encoded action."""

    def greedy(self, values: np.ndarray) -> Any:
        """Return the encoded action of the highest value, values float32 (outputs,)."""

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
        if not 1 <= len(self.commands) <= MAX_ACTIONS:
            raise ModelError(f'{len(self.commands)} actions; accepted: 1 to {MAX_ACTIONS}')
        if len(self.names) != len(self.commands) or len(set(self.names)) != len(self.names):
            raise ModelError('every action needs a name of its own')
        for name, command in zip(self.names, self.commands):
            # written so that NaN fails: every comparison with it is False
            if not all(-1 <= value <= 1 for value in command):
                raise ModelError(f'action {name!r} is {tuple(command)}; '
                                 'accepted: linear and angular from -1 to 1')

    def __len__(self) -> int:
        return len(self.commands)

    def encode(self, command: Command) -> int:
        """
        Return the index of the action that a command meant.

        Raises:
            MessageError: none of the table is within `TOLERANCE` in both numbers.
        """
        distances = [
            max(abs(given - own) for given, own in zip(command, candidate))
            for candidate in self.commands]
        distance = min(distances)
        if not distance <= TOLERANCE:
            linear, angular = command
            raise MessageError(
                f'linear {linear:g}, angular {angular:g} is no action of {self.name!r}')
        return distances.index(distance)

    def decode(self, action: int) -> Command:
        """Return the command of an index."""
        return self.commands[action]

    def greedy(self, values: np.ndarray) -> int:
        """Return the index of the highest value."""
        return int(values.argmax())

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
        if not all(isinstance(text, str) and 0 < len(text) <= 80 for text in (name, *names)):
            raise ModelError('names of actions must be texts of 1 to 80 characters')
        if not all(math.isfinite(value) for command in commands for value in command):
            raise ModelError('action space: values must be finite')
        return cls(name, names, commands)


KINDS = {Discrete.kind: Discrete}


def read_action_space(values: Any) -> ActionSpace:
    """Read what `to_json` of any kind gives, from a source that is not trusted: ModelError."""
    kind = values.get('kind') if isinstance(values, dict) else None
    if kind not in KINDS:
        raise ModelError(f'action space of kind {kind!r}; accepted: {", ".join(KINDS)}')
    return KINDS[kind].from_json(values)


def _make(name: str, *rows: tuple[str, float, float]) -> Discrete:
    return Discrete(
        name, tuple(row[0] for row in rows), tuple(Command(*row[1:]) for row in rows))


ACTION_SPACES = {
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
        # three ways to steer x gas, coast and a light brake
        _make(
            'grid9',
            ('left gas', 0.2, 0.3),
            ('gas', 1.0, 0.0),
            ('right gas', 0.2, -0.3),
            ('left', 0.0, 1.0),
            ('none', 0.0, 0.0),
            ('right', 0.0, -1.0),
            ('left brake', -0.2, 0.3),
            ('brake', -0.4, 0.0),
            ('right brake', -0.2, -0.3),
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

# the five actions of the report, which its dummy agent (3.2.3) draws from
DUMMY_SPACE = ACTION_SPACES['seed5']


def action_space(name: str) -> ActionSpace:
    """Return a space by name; raises ModelError for a name that is not there."""
    if name not in ACTION_SPACES:
        raise ModelError(f'action space {name!r}; accepted: {", ".join(ACTION_SPACES)}')
    return ACTION_SPACES[name]
