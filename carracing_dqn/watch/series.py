# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Named numbers of the last minutes, for plots."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import math

from msgs_bridge.plain_text import plain

# what a plot reaches back to, and how near two points of it may be; seconds
KEPT_SECONDS = 300.0
LEAST_GAP = 0.25
MAX_NAMES = 400
# a name of which nothing has come for so long makes room for another; seconds
QUIET_SECONDS = 5.0
MAX_NAME = 150
MAX_POINTS = int(KEPT_SECONDS / LEAST_GAP)


class SeriesTable:
    """Series of numbers by name; bounded in names, points and time."""

    def __init__(self) -> None:
        """Begin empty."""
        self._series: dict[str, deque[tuple[float, float]]] = {}
        self._full_until = -math.inf

    def __len__(self) -> int:
        return len(self._series)

    @property
    def names(self) -> list[str]:
        """Return the names in the order in which they came."""
        return list(self._series)

    def add(self, at: float, values: Mapping[str, float], prefix: str = '') -> None:
        """Keep values of a moment in s; those too soon after the last ones are left out."""
        for name, value in values.items():
            # it is shown, and asked for, as it is kept
            name = plain(f'{prefix}{name}', MAX_NAME)
            points = self._series.get(name)
            if points is None:
                if len(self._series) >= MAX_NAMES and not self._drop_one(at):
                    continue
                points = self._series[name] = deque(maxlen=MAX_POINTS)
            if points and at < points[-1][0]:
                # a bag was wound back
                points.clear()
            if math.isfinite(value) and not (points and at - points[-1][0] < LEAST_GAP):
                points.append((at, value))

    def _drop_one(self, at: float) -> bool:
        """Make room: forget the name of which nothing has come for the longest; False: all do."""
        if at < self._full_until:
            return False
        newest = {name: points[-1][0] if points else -math.inf
                  for name, points in self._series.items()}
        oldest = min(newest, key=newest.__getitem__)
        self._full_until = newest[oldest] + QUIET_SECONDS
        if at < self._full_until:
            return False
        del self._series[oldest]
        return True

    def points(self, name: str, now: float) -> list[tuple[float, float]]:
        """Return (seconds ago, value) of the last minutes, oldest first."""
        return [(now - at, value) for at, value in self._series.get(name, ())
                if now - at <= KEPT_SECONDS]
