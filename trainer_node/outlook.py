# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where a run that is limited by the clock will end, by the pace of the last minute."""
from __future__ import annotations

from collections import deque

from trainer_node import schedules
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.model_selection import Moment
from trainer_node.settings import TOO_SLOW

# The pace is that of so many seconds, of a short run that of a tenth of it: at first nothing is
# learned, and a machine is faster than later on.
WINDOW_SECONDS = 60.0
LEAST_WINDOW_SECONDS = 20.0
# how far apart the moments are that it is measured between; seconds
STEP_SECONDS = 1.0
# share of its fall that epsilon may lack at the end of a run before that is said
LACKING = 0.1
# share of the run in which epsilon falls by what is proposed, as in the shipped presets
FALL = 0.5


class Outlook:
    """
    Says what epsilon will be at the end of a run, and whether the machine is too slow for it.

    Only `run_minutes` ends a run whatever was done until then; without it nothing is said.

    Attributes:
        epsilon: at the end of the run; None as long as that is not known.
        warning: that the machine is too slow for the recipe, and what would fit; '' if it is not.
    """

    def __init__(self, settings: Hyperparameters) -> None:
        """Begin without a pace."""
        self._settings = settings
        self._window = min(
            WINDOW_SECONDS, max(LEAST_WINDOW_SECONDS, settings.run_minutes * 60 / 10))
        self._moments: deque[Moment] = deque()
        self.epsilon: float | None = None
        self.warning = ''

    def note(self, now: Moment) -> None:
        """Take note of how far the run is; moments come in their order."""
        moments = self._moments
        if not self._settings.run_minutes or (
                moments and now.wall_seconds - moments[-1].wall_seconds < STEP_SECONDS):
            return
        moments.append(now)
        while len(moments) > 2 and now.wall_seconds - moments[1].wall_seconds >= self._window:
            moments.popleft()
        seconds = now.wall_seconds - moments[0].wall_seconds
        if seconds >= self._window:
            self._project(moments[0], now, seconds)

    def _project(self, before: Moment, now: Moment, seconds: float) -> None:
        settings = self._settings
        left = max(settings.run_minutes * 60 - now.wall_seconds, 0.0)
        decisions = (now.decisions - before.decisions) / seconds
        episodes = (now.episode - before.episode) / seconds
        last_decision = now.decisions + int(decisions * left)
        last_episode = now.episode + int(episodes * left)
        self.epsilon = schedules.epsilon(
            settings, episodes=last_episode, decisions=last_decision)
        end, fall = settings.epsilon_end, settings.epsilon_start - settings.epsilon_end
        if self.epsilon <= end + LACKING * fall:
            self.warning = ''
            return
        if settings.epsilon_schedule == 'episodes':
            pace = f'{60 * episodes:.1f} episodes/min'
            # by which it would be down to a hundredth of its fall
            fits = f'epsilon_decay={0.01 ** (1 / max(FALL * last_episode, 1)):.3g}'
        else:
            pace = f'{decisions:.0f} decisions/s'
            # with two digits
            fits = f'epsilon_decisions={max(float(f"{FALL * last_decision:.1e}"), 1):.0f}'
        self.warning = (
            f'{TOO_SLOW}: at {pace} epsilon ends at {self.epsilon:.2f}, not '
            f'{end:g}; more --minutes, or --set {fits}')
