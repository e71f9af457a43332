# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How many updates are due: samples for each transition that came in."""
from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class LimiterState:
    """What a limiter has counted; see `ReplayRatioLimiter`."""

    transitions: int
    counted: int
    samples: int
    owed: float


class ReplayRatioLimiter:
    """
    Holds the replay ratio by counting, so that it does not depend on the machine's speed.

    An idea of Reverb's SampleToInsertRatio. Each transition that comes in is credited with
    samples, an update takes a batch of them. Only the credit that is open is carried on: what
    came in before learning started is not made up for in a burst, and neither is what came in
    before a run was resumed with another ratio or batch size.

    Attributes:
        transitions: transitions that came in.
        counted: how many of them samples were credited for.
        samples: samples drawn.
        owed: samples credited and not drawn yet; below `batch_size` when no update is due.
    """

    def __init__(
        self, samples_per_transition: float, batch_size: int, learning_starts: int,
    ) -> None:
        """Allow `samples_per_transition` samples for every transition after the first ones."""
        self.samples_per_transition = samples_per_transition
        self.batch_size = batch_size
        self.learning_starts = learning_starts
        self.transitions = self.counted = self.samples = 0
        self.owed = 0.0

    def insert(self) -> None:
        """Count a transition that came in."""
        self.transitions += 1
        if self.transitions > self.learning_starts:
            self.counted += 1
            self.owed += self.samples_per_transition

    def due(self) -> bool:
        """Return whether an update is due."""
        return self.owed >= self.batch_size

    def sampled(self) -> None:
        """Count an update."""
        self.owed -= self.batch_size
        self.samples += self.batch_size

    @property
    def ratio(self) -> float:
        """Return samples drawn for each transition that came in after learning started."""
        return self.samples / self.counted if self.counted else 0.0

    def state(self) -> LimiterState:
        """Return what was counted."""
        return LimiterState(self.transitions, self.counted, self.samples, self.owed)

    def restore(self, state: LimiterState) -> None:
        """Go on from a state, which may be of another ratio, batch size or start."""
        self.transitions, self.counted, self.samples = (
            state.transitions, state.counted, state.samples)
        # of a larger batch more may be open than one of the present size
        self.owed = min(state.owed, float(self.batch_size))
