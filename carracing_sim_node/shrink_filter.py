# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The arithmetic of pygame's `transform.smoothscale` from 1000x800 down to 96x96, as tables.

pygame-ce shrinks first every row and then every column by averaging areas in 2.14 fixed point:
an output pixel is the sum of the whole input pixels in its window and of the fractions of the two
at its ends, each fraction cut to a whole number, times the reciprocal of the window's width, cut
again (`filter_shrink_X_SSE2` and `filter_shrink_Y_SSE2`, which NEON machines use as well). The
window's width is cut to 14 bits, too, so the windows drift by a few 1/16384 of a pixel.
"""

from typing import NamedTuple

import numpy as np

_ONE = 0x4000
_RECIPROCAL_OF_ONE = 0x40000000

_NO_WEIGHT = 64
"""Up to this weight a fraction of the brightest pixel is still cut to zero: 1020 * 64 < 65536."""


class ShrinkTables(NamedTuple):
    """How one axis of length `source` shrinks to `target` pixels."""

    first: np.ndarray
    """int32 (target,): first input pixel that has any weight in each window."""

    last: np.ndarray
    """int32 (target,): last input pixel of each window."""

    first_weight: np.ndarray
    """int32 (target,): weight of `first` in 1/16384, or 16384 where it counts in full."""

    last_weight: np.ndarray
    """int32 (target,): weight of `last` in 1/16384."""

    flat: np.ndarray
    """uint8 (256,): output of any window in which every input pixel has one value."""

    window_low: np.ndarray
    """int32 (source,): first window in which each input pixel has weight."""

    window_high: np.ndarray
    """int32 (source,): last window in which each input pixel has weight."""

    reciprocal: int
    """Factor of a window's sum, in 1/65536."""


def shrink_tables(source: int, target: int) -> ShrinkTables:
    """
    Follow the counters of pygame's shrinking filter along one axis.

    Args:
        source: Input pixels along the axis.
        target: Output pixels along the axis, fewer than `source`.

    Raises:
        ValueError: If windows of one colour do not all give the same output for these sizes.
    """
    width = _ONE * source // target
    reciprocal = _RECIPROCAL_OF_ONE // width
    first = np.zeros(target, np.int32)
    last = np.zeros(target, np.int32)
    first_weight = np.full(target, _ONE, np.int32)
    last_weight = np.zeros(target, np.int32)
    window = 0
    counter = width
    for pixel in range(source):
        if counter > _ONE:
            counter -= _ONE
            continue
        last[window] = pixel
        last_weight[window] = counter
        rest = _ONE - counter
        counter = width - rest
        window += 1
        if window == target:
            break
        shared = rest > _NO_WEIGHT
        first[window] = pixel if shared else pixel + 1
        first_weight[window] = rest if shared else _ONE

    value = np.arange(256)
    flat = np.zeros(256, np.int64)
    window_low = np.full(source, target, np.int32)
    window_high = np.zeros(source, np.int32)
    for window in range(target):
        whole = last[window] - first[window] - 1
        total = whole * value
        total += value if first_weight[window] == _ONE else value * 4 * first_weight[window] >> 16
        total += value * 4 * last_weight[window] >> 16
        total = total * reciprocal >> 16
        if window and (total != flat).any():
            raise ValueError(f'{source} to {target}: windows of one colour differ')
        flat = total
        inside = slice(first[window], last[window] + 1)
        window_low[inside] = np.minimum(window_low[inside], window)
        window_high[inside] = np.maximum(window_high[inside], window)
    return ShrinkTables(
        first,
        last,
        first_weight,
        last_weight,
        flat.astype(np.uint8),
        window_low,
        window_high,
        reciprocal,
    )
