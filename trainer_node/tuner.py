# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The tuner of the report's section 5.2: which of two action spaces is driven with, and how often.

An action space that has both single commands and axes is two spaces in one network. A training
episode is driven with one of them; after a series of episodes the returns of both are averaged,
and the share of the better one grows. All of it is learned from, whichever was driven with, and
the finished model chooses from both.
"""
from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from dqn_policy_node.action_space import action_space
from dqn_policy_node.weights_message import AXES_SHARE
from msgs_bridge.twists import Command
from trainer_node.hyperparameters import Hyperparameters


MOST_SERIES = 10_000
"""What is remembered of; the record of a model, in which they are, is to stay readable."""


@dataclasses.dataclass(frozen=True)
class Series:
    """
    One series of episodes.

    Attributes:
        episodes: training episodes when it ended.
        share: of the episodes that were to be driven with the axes in it.
        commands, axes: mean return of those that were driven with each; None without any.
    """

    episodes: int
    share: float
    commands: float | None
    axes: float | None


@dataclasses.dataclass(frozen=True)
class TunerState:
    """What a `Tuner` is; see its attributes."""

    share: float
    of_commands: list[float]
    of_axes: list[float]
    present: dict[str, list[int]]
    series: list[Series]


class Tuner:
    """
    Moves the share of the episodes that are driven with the axes.

    Attributes:
        State: what `state` returns.
        share: that of the episodes from now on, 0 to 1.
        series: those that have ended last, up to `MOST_SERIES`.
    """

    State = TunerState

    def __init__(self, settings: Hyperparameters) -> None:
        """Begin with equal shares."""
        self._settings = settings
        self._space = action_space(settings.action_space)
        self.share = 0.5
        self.series: list[Series] = []
        # returns of the present series
        self._of_commands: list[float] = []
        self._of_axes: list[float] = []
        # of the present episode of each source: its single commands, its decisions with the axes
        self._present: dict[str, list[int]] = {}

    def took(self, command: Command, source: str = '', *, goes_on: bool = True) -> None:
        """
        Take note of a decision that a car has driven.

        Args:
            command: what was driven.
            source: by which car, if there are several.
            goes_on: whether it follows the one before; else that one's episode may have been cut
                off, and is not counted as of this one.
        """
        mode = self._space.mode(self._space.encode(command))
        if not goes_on:
            self._present.pop(source, None)
        self._present.setdefault(source, [0, 0])[not self._space.single[mode]] += 1

    def episode_ended(self, episodes: int, episode_return: float, source: str = '') -> bool:
        """
        Take note of the end of an episode of a car; return whether it ended a series.

        An episode is of the space that most of its decisions were of.
        """
        single, with_axes = self._present.pop(source, [0, 0])
        (self._of_axes if with_axes > single else self._of_commands).append(episode_return)
        if len(self._of_axes) + len(self._of_commands) < self._settings.tuner_series:
            return False
        commands, axes = _mean(self._of_commands), _mean(self._of_axes)
        self.series.append(Series(episodes, self.share, commands, axes))
        del self.series[:-MOST_SERIES]
        if commands is not None and axes is not None and commands != axes:
            step = math.copysign(self._settings.tuner_step, axes - commands)
            least = self._settings.tuner_least
            self.share = min(max(round(self.share + step, 9), least), 1 - least)
        self._of_commands, self._of_axes = [], []
        return True

    def extra(self) -> dict[str, float]:
        """Return what goes out with the weights."""
        return {AXES_SHARE: self.share}

    def to_json(self) -> list[dict[str, Any]]:
        """Return the series for the record of the run."""
        return [dataclasses.asdict(series) for series in self.series]

    def state(self) -> TunerState:
        """Return what it is."""
        return TunerState(self.share, list(self._of_commands), list(self._of_axes),
                          {source: list(counts) for source, counts in self._present.items()},
                          list(self.series))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return nothing: it has no arrays."""
        return {}

    def restore(self, state: TunerState, _: object = None) -> None:
        """Go on from a checkpoint; ValueError if it does not fit."""
        if not 0 <= state.share <= 1:
            raise ValueError(f'the share of the axes is {state.share}')
        if any(len(counts) != 2 for counts in state.present.values()):
            raise ValueError('an episode of the tuner is counted by two numbers')
        least = self._settings.tuner_least
        self.share, self.series = min(max(state.share, least), 1 - least), list(state.series)
        self._of_commands, self._of_axes = list(state.of_commands), list(state.of_axes)
        self._present = {source: list(counts) for source, counts in state.present.items()}


def _mean(returns: list[float]) -> float | None:
    return math.fsum(returns) / len(returns) if returns else None
