# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The last few pictures, oldest first."""
from __future__ import annotations

import numpy as np


class FrameStack:
    """Holds `size` pictures of one shape; after a reset the first one fills every place."""

    def __init__(self, size: int, shape: tuple[int, int]) -> None:
        """Make room for `size` pictures of (H, W)."""
        self._pictures = np.zeros((size, *shape), np.uint8)
        self._empty = True

    def reset(self) -> None:
        """Forget what was seen: the next picture starts an episode."""
        self._empty = True

    def push(self, picture: np.ndarray) -> np.ndarray:
        """Add a picture, uint8 (H, W); return the stack, uint8 (size, H, W), valid until next."""
        if self._empty:
            self._pictures[:] = picture
            self._empty = False
        else:
            self._pictures[:-1] = self._pictures[1:]
            self._pictures[-1] = picture
        return self._pictures
