# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Losses by name: what an error of a prediction costs, elementwise.

Each takes a tensor of errors of any shape and returns one of the same shape; a learner decides
what the errors are and how their losses are averaged. Nothing here imports torch, so that settings
can name the losses without it.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def l1(error: Tensor) -> Tensor:
    """Return the size of each error: it pulls towards the median (report, 2.2.1)."""
    return error.abs()


def huber(error: Tensor) -> Tensor:
    """Return half the square of each error up to 1 and its size less 1/2 beyond (Huber 1964)."""
    size = error.abs()
    inner = size.clamp(max=1.0)
    return inner * (size - 0.5 * inner)


LOSSES: dict[str, Callable[[Tensor], Tensor]] = {'l1': l1, 'huber': huber}
