# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The wall time that a run has taken, over all its sessions."""
from __future__ import annotations

from collections.abc import Callable
import dataclasses

import numpy as np

from trainer_node.saved_state import Seconds


@dataclasses.dataclass(frozen=True)
class ClockState:
    """Wall seconds of a run over all its sessions."""

    seconds: Seconds


class RunClock:
    """
    Counts the wall seconds of a run over all its sessions.

    Attributes:
        State: what `state` returns.
        before: seconds of the sessions before this one.
    """

    State = ClockState

    def __init__(self, clock: Callable[[], float]) -> None:
        """Start with a clock that only goes forward."""
        self._clock = clock
        self._started = clock()
        self.before = 0.0

    @property
    def seconds(self) -> float:
        """Return the seconds so far."""
        return self.before + self._clock() - self._started

    def state(self) -> ClockState:
        """Return the seconds so far."""
        return ClockState(self.seconds)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return nothing: it has no arrays."""
        return {}

    def restore(self, state: ClockState, _: object = None) -> None:
        """Go on from a checkpoint."""
        self.before = state.seconds
