# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The last few observations, oldest first, at even distances in time."""
from __future__ import annotations

from collections import deque

import numpy as np


class FrameStack:
    """
    Gives `size` observations of one shape, `spacing` ns apart.

    Observations may come at any times: each place of the stack holds the newest that is as old as
    it should be, give or take an eighth of the spacing, for stamps jitter. So one who learned to
    decide every 80 ms can drive by deciding every 40 ms, on stacks like those it learned from.
    After a reset the first observation stands for all before it.
    """

    def __init__(self, size: int, shape: tuple[int, int], spacing: int = 1) -> None:
        """Make room for `size` observations of (H, W)."""
        self._stack = np.zeros((size, *shape), np.uint8)
        self._spacing = spacing
        self._tolerance = spacing // 8
        self._kept: deque[tuple[int, np.ndarray]] = deque()
        self._now = 0

    def reset(self) -> None:
        """Forget what was seen: the next observation starts an episode."""
        self._kept.clear()

    def push(self, observation: np.ndarray, elapsed: int | None = None) -> np.ndarray:
        """
        Add an observation and return the stack.

        Args:
            observation: uint8 (H, W), not changed afterwards by the caller.
            elapsed: ns since the observation before; None for `spacing`.

        Returns:
            uint8 (size, H, W), valid until the next call.
        """
        self._now += self._spacing if elapsed is None else elapsed
        kept = self._kept
        kept.append((self._now, observation))
        size = len(self._stack)
        latest = self._now + self._tolerance
        while len(kept) > 1 and kept[1][0] <= latest - (size - 1) * self._spacing:
            kept.popleft()
        place = len(kept) - 1
        for back in range(size):
            while place > 0 and kept[place][0] > latest - back * self._spacing:
                place -= 1
            self._stack[size - 1 - back] = kept[place][1]
        return self._stack
