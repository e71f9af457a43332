# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Epsilon and learning rate over a run."""
from __future__ import annotations

import dataclasses

from trainer_node.hyperparameters import Hyperparameters


def epsilon(settings: Hyperparameters, *, episodes: int, decisions: int) -> float:
    """
    Return the share of random actions.

    By episodes it falls by a factor after each (report, 2.2.1), by decisions on a line.
    """
    if settings.epsilon_schedule == 'episodes':
        value = settings.epsilon_start * settings.epsilon_decay ** episodes
    else:
        share = min(decisions / settings.epsilon_decisions, 1.0)
        value = settings.epsilon_start + share * (settings.epsilon_end - settings.epsilon_start)
    return max(value, settings.epsilon_end)


@dataclasses.dataclass(frozen=True)
class LearningRateState:
    """Where a learning rate is, and by which settings it came there; see `LearningRate`."""

    value: float
    best_reward: float | None
    episodes_without_better: int
    first_value: float
    schedule: str


class LearningRate:
    """
    The learning rate: constant, halved on plateaus (and back), or falling on a line.

    Attributes:
        value: the present rate.
        best_reward: best reward of an episode so far, None before the first one.
        episodes_without_better: how long that is ago.
    """

    def __init__(self, settings: Hyperparameters) -> None:
        """Start with the first rate."""
        self._settings = settings
        self.value = settings.learning_rate
        self.best_reward: float | None = None
        self.episodes_without_better = 0

    def episode_ended(self, reward: float) -> None:
        """
        Take note of an episode's reward; on a plateau halve the rate (report, 2.2.3).

        A better reward, or a halving, starts the patience anew; with `plateau_reset` a better
        reward brings the first rate back, too.
        """
        if self.best_reward is None or reward > self.best_reward:
            self.best_reward = reward
            self.episodes_without_better = 0
            if self._settings.learning_rate_schedule == 'plateau_reset':
                self.value = self._settings.learning_rate
            return
        self.episodes_without_better += 1
        if (self._settings.learning_rate_schedule in ('plateau', 'plateau_reset')
                and self.episodes_without_better >= self._settings.patience_episodes):
            self.value = max(self.value / 2, self._settings.learning_rate_end)
            self.episodes_without_better = 0

    def progressed(self, progress: float) -> None:
        """Take note of the share of the run that is done, 0 to 1."""
        settings = self._settings
        if settings.learning_rate_schedule != 'linear':
            return
        # of a rate that is held to the end nothing falls
        falls = 1 - settings.learning_rate_hold
        share = (progress - settings.learning_rate_hold) / falls if falls > 0 else 0.0
        share = min(max(share, 0.0), 1.0)
        self.value = settings.learning_rate + share * (
            settings.learning_rate_end - settings.learning_rate)

    def state(self) -> LearningRateState:
        """Return where it is."""
        return LearningRateState(
            self.value, self.best_reward, self.episodes_without_better,
            self._settings.learning_rate, self._settings.learning_rate_schedule)

    def restore(self, state: LearningRateState) -> None:
        """Go on from a state; a first rate or a schedule that has changed starts anew from it."""
        self.best_reward = state.best_reward
        self.episodes_without_better = state.episodes_without_better
        settings = self._settings
        if (state.first_value, state.schedule) == (
                settings.learning_rate, settings.learning_rate_schedule):
            self.value = max(state.value, settings.learning_rate_end)
