# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Means of the figures that updates give."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses


@dataclasses.dataclass(frozen=True)
class MeansState:
    """What `Means` has added up."""

    sums: dict[str, float]
    count: int


class Means:
    """Means of named figures since they were last taken."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._sums: dict[str, float] = {}
        self.count = 0

    def add(self, figures: Mapping[str, float]) -> None:
        """Add the figures of one update."""
        for name, value in figures.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self.count += 1

    def take(self) -> dict[str, float]:
        """Return the means by name, none if nothing was added, and begin anew."""
        means = {name: total / self.count for name, total in self._sums.items()}
        self._sums, self.count = {}, 0
        return means

    def state(self) -> MeansState:
        """Return what was added up."""
        return MeansState(dict(self._sums), self.count)

    def restore(self, state: MeansState) -> None:
        """Go on from a state."""
        self._sums, self.count = dict(state.sums), state.count
