# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Arithmetic in which numbers too small for a normal float32 are 0.

Adam's mean of the gradients of a unit that is never active again decays to such numbers and stays
there, since 0.9 of the smallest of them is rounded up to itself. Many processors take a hundred
times as long over each (figures in docs/learning.md).
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def flushed_denormals(on: bool) -> Iterator[None]:
    """
    Let numbers below 1.2e-38 be 0 within, in this thread alone; does nothing unless `on`.

    What else the thread computes, a simulator's physics for one, keeps the arithmetic of IEEE 754.
    A processor that cannot do it computes as ever.
    """
    if on:
        torch.set_flush_denormal(True)
    try:
        yield
    finally:
        if on:
            torch.set_flush_denormal(False)
