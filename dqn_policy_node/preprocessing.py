# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From an rgb frame to the gray observation that the network sees."""
from __future__ import annotations

import numpy as np

from dqn_policy_node.model_description import Preprocessing
from msgs_bridge.errors import MessageError

# gymnasium draws road at 102 plus 0, 2.55 or 5.1; its scaling blurs each by a level or so
ROAD_LEVELS = range(98, 108)
ROAD = 102
# darker with every level: brighter would end among the grass (136 to 145)
ROAD_CONTRAST = -9
# ITU-R BT.601, in 1/256
LUMA = (77, 150, 29)


class Preprocessor:
    """
    Turns frames into observations as a `Preprocessing` says; each call allocates one.

    Attributes:
        level_of_sum: uint8, the level of gray of each sum of the weighted channels.
    """

    def __init__(self, description: Preprocessing) -> None:
        """Prepare the tables for a description."""
        self.description = description
        self.shape = description.shape
        self._frame_shape = (description.frame_height, description.frame_width, 3)
        self._rows = slice(description.first_row, description.first_row + description.rows)
        self._columns = slice(
            description.first_column, description.first_column + description.columns)
        levels = np.arange(256)
        road = np.array(ROAD_LEVELS)
        if description.road == 'flat':
            levels[road] = ROAD
        elif description.road == 'contrast':
            levels[road] = ROAD + ROAD_CONTRAST * np.maximum(road - ROAD, 0)
        if description.gray == 'mean':
            # rounded mean of three channels, by their sum; of three equal ones the value itself
            self._weights = None
            sums = np.arange(3 * 255 + 1)
            self.level_of_sum = levels[(sums + 1) // 3].astype(np.uint8)
        else:
            self._weights = np.array(LUMA, np.uint16)
            self.level_of_sum = levels[np.arange(256 * 255 + 1) >> 8].astype(np.uint8)

    def __call__(self, frame: np.ndarray) -> np.ndarray:
        """
        Return the observation of a frame.

        Args:
            frame: uint8 (frame_height, frame_width, 3) rgb.

        Returns:
            uint8 (H, W), a new array.

        Raises:
            MessageError: the frame has another shape or type.
        """
        if frame.shape != self._frame_shape or frame.dtype != np.uint8:
            raise MessageError(
                f'frame is {frame.dtype} {frame.shape}; expected uint8 {self._frame_shape}')
        part = frame[self._rows, self._columns]
        if self._weights is None:
            sums = part[..., 0].astype(np.uint16)
            sums += part[..., 1]
            sums += part[..., 2]
        else:
            sums = part[..., 0] * self._weights[0]
            sums += part[..., 1] * self._weights[1]
            sums += part[..., 2] * self._weights[2]
        gray = self.level_of_sum.take(sums)
        shrink = self.description.shrink
        if shrink == 1:
            return gray
        height, width = self.shape
        rows = gray.reshape(height, shrink, shrink * width).sum(axis=1, dtype=np.uint16)
        total = rows[:, 0::shrink].copy()
        for column in range(1, shrink):
            total += rows[:, column::shrink]
        total += shrink * shrink // 2
        total //= shrink * shrink
        return total.astype(np.uint8)
