# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A value over a whole run, in bounded memory."""
from __future__ import annotations

import math
from pathlib import Path

from carracing_dqn.evaluation.statistics import moving_average
from carracing_dqn.evaluation.tables import read_table

MOST_POINTS = 512
PAST_COLUMNS = 'episode', 'train_reward', 'wall_seconds'


class Curve:
    """
    Points of a value that is told for hours.

    Attributes:
        points: (time, value), oldest first, `MOST_POINTS` at most.
    """

    def __init__(self) -> None:
        """Begin without points."""
        self.points: list[tuple[float, float]] = []
        self._gap = 0.0

    def add(self, at: float, value: float) -> None:
        """Keep a value at a time in s, unless it is too near to the last or not finite."""
        if not math.isfinite(at) or not math.isfinite(value):
            return
        if self.points and at < self.points[-1][0]:
            # another run
            self.points, self._gap = [], 0.0
        if self.points and at - self.points[-1][0] <= self._gap:
            return
        self.points.append((at, value))
        if len(self.points) == MOST_POINTS:
            # every other one is left out, of these and of those to come
            self.points = self.points[::2]
            self._gap = 2 * (at - self.points[0][0]) / MOST_POINTS


def past_returns(episodes: Path, count: int, window: int) -> list[tuple[float, float]]:
    """
    Return the moving average of a run's returns over its wall seconds, as far as it goes on.

    Args:
        episodes: its episodes.csv; whatever of it cannot be read is left out.
        count: how many episodes the run has behind it.
        window: of the average, in episodes.
    """
    table, _ = read_table(episodes, PAST_COLUMNS)
    if not table.has(*PAST_COLUMNS):
        return []
    numbers, returns, seconds = table.known(*PAST_COLUMNS)
    past = numbers < count
    return list(zip(seconds[past].tolist(), moving_average(returns[past], window).tolist()))
