# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How many updates are due: samples for each transition that came in."""
from __future__ import annotations


class ReplayRatioLimiter:
    """
    Holds the replay ratio by counting, so that it does not depend on the machine's speed.

    An idea of Reverb's SampleToInsertRatio. Counting starts when learning starts: what came in
    before is not made up for in a burst.
    """

    def __init__(
        self, samples_per_transition: float, batch_size: int, learning_starts: int,
    ) -> None:
        """Allow `samples_per_transition` samples for every transition after the first ones."""
        self.samples_per_transition = samples_per_transition
        self.batch_size = batch_size
        self.learning_starts = learning_starts
        self.transitions = 0
        self.updates = 0

    def insert(self) -> None:
        """Count a transition that came in."""
        self.transitions += 1

    def due(self) -> bool:
        """Return whether an update is due."""
        counted = self.transitions - self.learning_starts
        return counted * self.samples_per_transition >= (self.updates + 1) * self.batch_size

    def sampled(self) -> None:
        """Count an update."""
        self.updates += 1

    @property
    def ratio(self) -> float:
        """Return samples drawn for each transition that came in after learning started."""
        counted = self.transitions - self.learning_starts
        return self.updates * self.batch_size / counted if counted > 0 else 0.0
