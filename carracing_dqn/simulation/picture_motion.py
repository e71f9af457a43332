# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Which way a picture moves from one frame to the next."""
from __future__ import annotations

from collections.abc import Iterable, Sequence
import statistics

import numpy as np

# what two frames must have in common to say anything, as a share of a perfect match
CLEAR = 0.1
# pixels a frame; less is noise
LEAST_SHIFT = 0.05


def sideways_shift(before: np.ndarray, after: np.ndarray) -> float | None:
    """
    Return by how many pixels the upper half of a picture moved to the right, or None.

    By phase correlation (Kuglin and Hines 1975). Ahead of a car that turns to the left the world
    moves to the right, in a camera on its bonnet and in one that looks down on it heading up.

    Args:
        before: uint8 (H, W, 3).
        after: the next frame, of the same size.
    """
    first, second = (_upper(one) for one in (before, after))
    spectrum = np.fft.rfft2(second) * np.conj(np.fft.rfft2(first))
    size = np.abs(spectrum)
    if not size.any():
        return None
    match = np.fft.irfft2(spectrum / np.maximum(size, 1e-9), first.shape)
    row, column = np.unravel_index(match.argmax(), match.shape)
    if match[row, column] < CLEAR:
        return None
    around = match[row, [(column - 1) % match.shape[1], column, (column + 1) % match.shape[1]]]
    fine = _peak(*around)
    shift = column + fine
    return float(shift - match.shape[1] if shift > match.shape[1] / 2 else shift)


def turning(frames: Sequence[np.ndarray]) -> float | None:
    """Return the median shift of a series of frames that follow each other, or None."""
    shifts = [shift for pair in zip(frames, frames[1:])
              if (shift := sideways_shift(*pair)) is not None]
    return statistics.median(shifts) if shifts else None


def turned_left(
    left: Iterable[Sequence[np.ndarray]], right: Iterable[Sequence[np.ndarray]],
) -> bool | None:
    """
    Return whether a car turned left when it was told to, or None if its pictures do not say.

    Every turn to one side must move the picture further than every turn to the other, so that a
    camera that moves by itself is not taken for one that obeys.

    Args:
        left: the frames of each time that it was told to turn left.
        right: and of each that it was told to turn right.
    """
    to_left, to_right = ([turning(frames) for frames in turns] for turns in (left, right))
    if not to_left or not to_right or None in (*to_left, *to_right):
        return None
    if min(to_left) > max(to_right) + LEAST_SHIFT:
        return True
    return False if min(to_right) > max(to_left) + LEAST_SHIFT else None


def _upper(pixels: np.ndarray) -> np.ndarray:
    """Return the upper half as gray, its edges faded so that they match nothing."""
    gray = pixels[:max(2, len(pixels) // 2)].mean(2)
    gray = gray - gray.mean()
    return gray * np.hanning(gray.shape[0])[:, None] * np.hanning(gray.shape[1])


def _peak(before: float, at: float, after: float) -> float:
    """Return where a parabola through three values is highest, as an offset from the middle."""
    bend = before - 2 * at + after
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5))
