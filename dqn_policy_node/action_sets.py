# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Discrete actions as data: what each means for steering, gas and brake.

A set never has gas and brake together, because one signed number of a twist carries both.
CarRacing's wheels turn by at most 0.4 rad, so a steer of 0.4 already asks for full lock and only
smaller ones are gentle.
"""
from __future__ import annotations

import dataclasses
import math

from dqn_policy_node.errors import ModelError
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Action

MAX_ACTIONS = 64
# a twist that went through float32 is off by less than 1e-7; neighbours differ by 0.05 or more
TOLERANCE = 0.01


@dataclasses.dataclass(frozen=True)
class ActionSet:
    """
    A named table of discrete actions.

    Attributes:
        name: name of the set.
        names: name of each action, unique.
        actions: steer, gas and brake of each action, in the same order.
    """

    name: str
    names: tuple[str, ...]
    actions: tuple[Action, ...]

    def __post_init__(self) -> None:
        """Check the table; raises ModelError."""
        if not 1 <= len(self.actions) <= MAX_ACTIONS:
            raise ModelError(f'{len(self.actions)} actions; accepted: 1 to {MAX_ACTIONS}')
        if len(self.names) != len(self.actions) or len(set(self.names)) != len(self.names):
            raise ModelError('every action needs a name of its own')
        for name, (steer, gas, brake) in zip(self.names, self.actions):
            if not (-1 <= steer <= 1 and 0 <= gas <= 1 and 0 <= brake <= 1):
                raise ModelError(f'action {name!r} is {(steer, gas, brake)}; '
                                 'accepted: steer -1 to 1, gas and brake 0 to 1')
            if gas > 0 and brake > 0:
                raise ModelError(f'action {name!r} has gas {gas} and brake {brake} at once')

    def __len__(self) -> int:
        return len(self.actions)

    def nearest(self, action: Action) -> int:
        """
        Return the index of the action that a twist meant.

        Raises:
            MessageError: none of the set is within `TOLERANCE` in every component.
        """
        distances = [
            max(abs(given - own) for given, own in zip(action, candidate))
            for candidate in self.actions]
        distance = min(distances)
        if not distance <= TOLERANCE:
            steer, gas, brake = action
            raise MessageError(f'steer {steer:g}, gas {gas:g}, brake {brake:g} is no action of '
                               f'{self.name!r}')
        return distances.index(distance)

    def mirrored(self) -> tuple[int, ...]:
        """
        Return for each action the index of the one that steers the other way.

        Raises:
            ModelError: the set is not symmetric.
        """
        try:
            return tuple(
                self.nearest(Action(-steer, gas, brake)) for steer, gas, brake in self.actions)
        except MessageError as error:
            raise ModelError(f'the action set cannot be mirrored: {error}') from None

    def to_json(self) -> dict[str, object]:
        """Return the set as JSON values."""
        return {
            'name': self.name,
            'actions': [
                {'name': name, 'steer': action.steer, 'gas': action.gas, 'brake': action.brake}
                for name, action in zip(self.names, self.actions)],
        }

    @classmethod
    def from_json(cls, values: object) -> ActionSet:
        """Read what `to_json` gives; raises ModelError."""
        try:
            rows = values['actions']
            names = tuple(row['name'] for row in rows)
            actions = tuple(
                Action(*(float(row[key]) for key in ('steer', 'gas', 'brake'))) for row in rows)
            name = values['name']
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise ModelError(f'action set: {type(error).__name__} {error}') from None
        if not all(isinstance(text, str) and 0 < len(text) <= 80 for text in (name, *names)):
            raise ModelError('names of actions must be texts of 1 to 80 characters')
        if not all(math.isfinite(value) for action in actions for value in action):
            raise ModelError('action set: values must be finite')
        return cls(name, names, actions)


def _make(name: str, *rows: tuple[str, float, float, float]) -> ActionSet:
    return ActionSet(
        name, tuple(row[0] for row in rows), tuple(Action(*row[1:]) for row in rows))


ACTION_SETS = {
    action_set.name: action_set for action_set in (
        # the report, section 2.2.2
        _make(
            'seed5',
            ('none', 0.0, 0.0, 0.0),
            ('left', -1.0, 0.0, 0.0),
            ('right', 1.0, 0.0, 0.0),
            ('gas', 0.0, 1.0, 0.0),
            ('brake', 0.0, 0.0, 0.8),
        ),
        # gentle gas in bends, a light brake that does not lock the wheels
        _make(
            'gentle7',
            ('none', 0.0, 0.0, 0.0),
            ('left', -1.0, 0.0, 0.0),
            ('right', 1.0, 0.0, 0.0),
            ('gas', 0.0, 1.0, 0.0),
            ('brake', 0.0, 0.0, 0.4),
            ('left gas', -0.3, 0.2, 0.0),
            ('right gas', 0.3, 0.2, 0.0),
        ),
        # three ways to steer x gas, coast and a light brake
        _make(
            'grid9',
            ('left gas', -0.3, 0.2, 0.0),
            ('gas', 0.0, 1.0, 0.0),
            ('right gas', 0.3, 0.2, 0.0),
            ('left', -1.0, 0.0, 0.0),
            ('none', 0.0, 0.0, 0.0),
            ('right', 1.0, 0.0, 0.0),
            ('left brake', -0.3, 0.0, 0.2),
            ('brake', 0.0, 0.0, 0.4),
            ('right brake', 0.3, 0.0, 0.2),
        ),
        # as grid9, with gentle steering beside full lock
        _make(
            'fine11',
            ('left', -1.0, 0.0, 0.0),
            ('gentle left', -0.15, 0.0, 0.0),
            ('none', 0.0, 0.0, 0.0),
            ('gentle right', 0.15, 0.0, 0.0),
            ('right', 1.0, 0.0, 0.0),
            ('left gas', -0.3, 0.2, 0.0),
            ('gas', 0.0, 1.0, 0.0),
            ('right gas', 0.3, 0.2, 0.0),
            ('left brake', -0.3, 0.0, 0.2),
            ('brake', 0.0, 0.0, 0.5),
            ('right brake', 0.3, 0.0, 0.2),
        ),
    )
}


def action_set(name: str) -> ActionSet:
    """Return a set by name; raises ModelError for a name that is not there."""
    if name not in ACTION_SETS:
        raise ModelError(f'action set {name!r}; accepted: {", ".join(ACTION_SETS)}')
    return ACTION_SETS[name]
