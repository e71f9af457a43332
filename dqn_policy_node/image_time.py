# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
How images follow each other in time, by stamps that may be anything.

The rule:
- Only differences of stamps count: simulation time and wall time are alike.
- A stamp a little ahead of the last one is the next image. Further ahead than the *gap*, or
  behind by more: a new sequence begins, and what was seen before it is forgotten. So a simulator
  needs to say nothing of its resets if its stamps jump then.
- A stamp behind by less than the gap is a late image, which changes nothing; a second one in a row
  means that time has gone back, and a new sequence begins.
- An equal stamp with equal pixels is the same image sent again.
- An equal stamp with other pixels (a stamp that stands, or zeros) is a camera without usable
  stamps: then the time of arrival counts, until stamps have risen ten times in a row.
"""
from __future__ import annotations

from collections.abc import Callable
import enum

# images whose stamps rise, after which they are believed again
RISING = 10


class Place(enum.Enum):
    """Where an image stands in time."""

    FIRST = 'begins a sequence'
    NEXT = 'follows the one before'
    AGAIN = 'is the one before, sent again'
    LATE = 'is older than one that was seen'


class ImageTime:
    """Places images one after the other."""

    def __init__(self, gap: int) -> None:
        """Begin a new sequence at gaps above `gap`, ns."""
        self._gap = gap
        self._stamp: int | None = None
        self._arrived = 0
        self._rising = RISING
        self._late = False

    @property
    def by_stamp(self) -> bool:
        """Return whether stamps count, not the time of arrival."""
        return self._rising >= RISING

    def place(self, stamp: int, arrived: int, same: Callable[[], bool]) -> tuple[Place, int]:
        """
        Return where an image stands and the ns since the one before (0 unless it is the next).

        Args:
            stamp: of the image, ns.
            arrived: when it came by a clock that never goes back, ns.
            same: tells whether its pixels are those of the image before.
        """
        last, last_arrived = self._stamp, self._arrived
        self._arrived = arrived
        if last is None:
            self._stamp = stamp
            return Place.FIRST, 0
        step = stamp - last
        if step == 0:
            if same():
                return Place.AGAIN, 0
            self._rising = 0
        elif not self.by_stamp:
            self._rising = self._rising + 1 if step > 0 else 0
        elif -self._gap <= step < 0 and not self._late:
            self._late = True
            return Place.LATE, 0
        self._stamp, self._late = stamp, False
        elapsed = step if self.by_stamp else arrived - last_arrived
        return (Place.NEXT, elapsed) if 0 < elapsed <= self._gap else (Place.FIRST, 0)
