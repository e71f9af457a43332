# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Reads stacks of observations channels-last, the order in which the CPU's convolutions take them.

Turning a batch afterwards, byte by byte, takes ten times as long as reading it (docs/learning.md).
"""
from __future__ import annotations

import numpy as np

from msgs_bridge.compiled import compiled


def gather_stacks(observations: np.ndarray, slots: np.ndarray, out: np.ndarray) -> None:
    """
    Read stacks of observations.

    Args:
        observations: uint8 (capacity, H, W).
        slots: int64 (N, stack), which observations each stack is made of, all of them in range.
        out: uint8 (N, H, W, stack), contiguous; the stacks are written there.
    """
    count, stack = slots.shape
    if stack == 4:
        _gather_four(observations.reshape(len(observations), -1), slots, out.reshape(count, -1))
        return
    for place in range(stack):
        out[..., place] = observations[slots[:, place]]


@compiled
def _gather_four(observations, slots, out):
    # four observations by name: only so does the compiler interleave whole registers
    for number in range(len(slots)):
        first, second = observations[slots[number, 0]], observations[slots[number, 1]]
        third, fourth = observations[slots[number, 2]], observations[slots[number, 3]]
        stack = out[number]
        for pixel in range(observations.shape[1]):
            stack[4 * pixel] = first[pixel]
            stack[4 * pixel + 1] = second[pixel]
            stack[4 * pixel + 2] = third[pixel]
            stack[4 * pixel + 3] = fourth[pixel]
