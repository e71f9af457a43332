# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Which tracks are driven again at once: those that went worse than most, for training."""
from __future__ import annotations

from collections import deque

WINDOW = 100
"""Returns that an episode is compared with."""
LEAST = 20
"""Returns without which nothing can be said of one."""
LOWEST = 0.1


class TrackRetries:
    """
    Says after each episode whether its track is driven again.

    Where an agent does badly it has most to learn (prioritized level replay, arXiv 2010.03934,
    with the return as the score). No list is kept: a track comes again at once.
    """

    def __init__(self, most: int) -> None:
        """Allow so many retries of a track; 0 = none."""
        self._most = most
        self._made = 0
        self._returns: deque[float] = deque(maxlen=WINDOW)

    def again(self, episode_return: float) -> bool:
        """Return whether an episode's return was among the lowest, and retries are left."""
        lowest = (len(self._returns) >= LEAST and
                  episode_return < sorted(self._returns)[int(LOWEST * len(self._returns))])
        if not self._made:
            # a hard track counts once, or hard ones would set what is low
            self._returns.append(episode_return)
        self._made = self._made + 1 if lowest and self._made < self._most else 0
        return self._made > 0
