# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Shaping: what training adds to the reward of the environment, as named, weighted terms.

Every term is a function of two neighbouring steps, so one recording can be learned from with any
shaping. With all weights at zero the reward is the environment's own, and nothing but the core of
`step` is needed. A new term is a function and a line in `TERMS` (docs/extending.md).
"""
from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from typing import NamedTuple

from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import MAX_REWARD
from msgs_bridge.transitions import Transition
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters

# what is paid by time is paid for each 1/50 s, whatever the simulator's frames are
UNITS_A_SECOND = 50
# no command is held for longer than a minute, whatever the stamps say
MAX_UNITS = 60 * UNITS_A_SECOND


class Change(NamedTuple):
    """
    What a term looks at.

    Attributes:
        info: values of the step after the command, by name.
        before: values of the step before it.
        time: simulated time between the two in units of 1/50 s.
    """

    info: dict[str, float]
    before: dict[str, float]
    time: float

    def grown(self, name: str) -> float:
        """Return by how much a value has grown."""
        return self.info[name] - self.before[name]

    def begun(self, *names: str) -> bool:
        """Return whether one of some flags is set now and none was before."""
        return (any(self.info[name] > 0 for name in names)
                and not any(self.before[name] > 0 for name in names))


@dataclasses.dataclass(frozen=True)
class Term:
    """
    One term.

    Attributes:
        weight: the hyperparameter that switches it on: anything but 0.
        info: names of the step's values that it needs.
        points: what it adds to the reward.
        settings: further hyperparameters that it depends on.
    """

    weight: str
    info: tuple[str, ...]
    points: Callable[[Hyperparameters, Change], float]
    settings: tuple[str, ...] = ()


def _tile_missed(settings: Hyperparameters, change: Change) -> float:
    # a tile that is fetched later gives its points back
    return -min(settings.tile_missed_penalty * change.grown('tiles_missed'),
                settings.tile_missed_limit)


def _off_road(settings: Hyperparameters, change: Change) -> float:
    return -settings.off_road_penalty * change.info['wheels_off_road'] * change.time


def _standing(settings: Hyperparameters, change: Change) -> float:
    return -standing_points(settings, int(change.info['standing_still']), round(change.time))


def _progress(settings: Hyperparameters, change: Change) -> float:
    return settings.progress_weight * change.grown('tiles_visited') / _tiles(change)


def _position(settings: Hyperparameters, change: Change) -> float:
    return settings.position_weight * change.grown('lap_position') / _tiles(change)


def _speed(settings: Hyperparameters, change: Change) -> float:
    return settings.speed_weight * change.info['speed'] / 100 * change.time


def _time(settings: Hyperparameters, change: Change) -> float:
    return -settings.time_penalty * change.time


def _finish(settings: Hyperparameters, change: Change) -> float:
    # once, however long the episode goes on afterwards
    return settings.finish_bonus * change.begun('lap_finished', 'came_round')


def _left_field(settings: Hyperparameters, change: Change) -> float:
    return settings.left_field_refund * change.begun('left_field')


def _early_end(settings: Hyperparameters, change: Change) -> float:
    missed_out = change.begun('ended_early') and not change.info['came_round'] > 0
    return -settings.early_end_penalty * missed_out


def _tiles(change: Change) -> float:
    return max(change.info['tiles_total'], 1.0)


TERMS = {
    'tile_missed': Term(
        'tile_missed_penalty', ('tiles_missed',), _tile_missed, ('tile_missed_limit',)),
    'off_road': Term('off_road_penalty', ('wheels_off_road',), _off_road),
    'standing': Term(
        'standing_penalty', ('standing_still',), _standing,
        ('standing_growth', 'standing_limit')),
    'progress': Term('progress_weight', ('tiles_visited', 'tiles_total'), _progress),
    'position': Term('position_weight', ('lap_position', 'tiles_total'), _position),
    'speed': Term('speed_weight', ('speed',), _speed),
    'time': Term('time_penalty', (), _time),
    'finish': Term('finish_bonus', ('lap_finished', 'came_round'), _finish),
    'left_field': Term('left_field_refund', ('left_field',), _left_field),
    'early_end': Term('early_end_penalty', ('ended_early', 'came_round'), _early_end),
}

REWARD_SETTINGS = ('reward_scale', 'early_end_terminal', 'truncated_terminal', *(
    name for term in TERMS.values() for name in (term.weight, *term.settings)))
"""What the rewards in a replay buffer were made with: none of it can change within a run."""


class Shaping:
    """The terms of a run that are switched on."""

    def __init__(self, settings: Hyperparameters) -> None:
        """Choose the terms whose weights are not 0."""
        self._settings = settings
        self._terms = {
            name: term for name, term in TERMS.items() if getattr(settings, term.weight)}
        self._checked = False

    def _check(self, transition: Transition) -> None:
        """
        See that the steps have what the terms need.

        Raises:
            LearningError: one is switched on whose values nobody publishes.
        """
        needed = {term.weight: term.info for term in self._terms.values()}
        if self._settings.early_end_terminal:
            needed['early_end_terminal'] = ('ended_early',)
        for setting, names in needed.items():
            for name in names:
                if name not in transition.step.info or name not in transition.previous.info:
                    raise LearningError(
                        f'{setting} is {getattr(self._settings, setting)} and needs {name!r}, '
                        'which step does not publish; without it: '
                        f'{setting}={"false" if setting == "early_end_terminal" else 0}')
        self._checked = True

    def terms(self, transition: Transition) -> dict[str, float]:
        """
        Return the points of each term that is on for one transition.

        Raises:
            LearningError: the first transition lacks a value that a term needs.
            MessageError: a later one does.
        """
        if not self._checked:
            self._check(transition)
        change = Change(
            transition.step.info, transition.previous.info,
            min((transition.next_stamp - transition.stamp) * UNITS_A_SECOND / NANOSECONDS,
                MAX_UNITS))
        try:
            return {name: term.points(self._settings, change)
                    for name, term in self._terms.items()}
        except KeyError as error:
            raise MessageError(f'step lacks {error.args[0]!r}') from None

    def reward(self, transition: Transition) -> float:
        """
        Return what is learned from: the environment's reward and all terms, scaled.

        Raises:
            LearningError, MessageError: as `terms`; a reward beyond MAX_REWARD is a MessageError.
        """
        terms = self.terms(transition).values()
        try:
            points = math.fsum(terms)
        except (ValueError, OverflowError):
            # of infinite ones of both signs, or beyond any float
            points = math.nan
        reward = self._settings.reward_scale * (transition.step.reward + points)
        if not abs(reward) <= MAX_REWARD:
            raise MessageError(f'the shaped reward is {reward}; accepted: up to {MAX_REWARD:g}')
        return reward

    def terminated(self, transition: Transition) -> bool:
        """Return whether nothing is worth anything after a transition."""
        settings, step = self._settings, transition.step
        return transition.terminated or (step.ended and (
            settings.truncated_terminal
            or settings.early_end_terminal and step.info.get('ended_early', 0.0) > 0))


def standing_points(settings: Hyperparameters, standing: int, new: int) -> float:
    """
    Return the penalty for standing still: growing exponentially with its time (report, 5.1).

    Args:
        settings: weight of the first 1/50 s, growth for each further one, and the most for one.
        standing: how many in a row that the car has stood still.
        new: how many of them are new.
    """
    weight, growth = settings.standing_penalty, settings.standing_growth
    if weight == 0 or standing == 0:
        return 0.0
    limit = settings.standing_limit
    # beyond this exponent the limit holds anyway, and a float may overflow
    highest = math.log(max(limit / weight, 1.0)) / math.log(growth) if growth > 1 else math.inf
    return sum(
        min(weight * growth ** min(frame, highest), limit)
        for frame in range(max(standing - new, 0), standing))
