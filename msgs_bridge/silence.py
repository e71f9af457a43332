# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
How long nothing has come on a topic, and whether its reader should be made anew.

A reader of Fast DDS was seen to hear nothing for minutes while others of the same publisher did.
From outside that is a silence, and so are a pause and a gap that the publisher is about to repair.
A new reader costs what is on its way to the old one: behind a link of 20 ms and 1 % loss one after
each 2 s of silence lost 190 to 240 of some 360 steps.
"""
from __future__ import annotations

import math
import time

# for those who only ever need the next message, and for those who need all of them
SHORT_SECONDS, LONG_SECONDS = 2.0, 20.0
MOST_SECONDS = 60.0


class Silence:
    """Measures the silence of one topic by wall time; one that was never heard is not missed."""

    def __init__(self, *, short: bool = False) -> None:
        """Begin now; `short` where only the next message is ever needed."""
        self._since = time.monotonic()
        self._first = SHORT_SECONDS if short else LONG_SECONDS
        self._patience = math.inf

    @property
    def seconds(self) -> float:
        """Return how long it is since a message came or the reader was made anew."""
        return time.monotonic() - self._since

    def end(self) -> None:
        """Note that a message has come."""
        self._since = time.monotonic()
        self._patience = self._first

    def begin_anew(self) -> None:
        """Note that the reader was made anew."""
        self._since = time.monotonic()

    def too_long(self) -> bool:
        """Return whether to make the reader anew, and wait twice as long for the next time."""
        if self.seconds <= self._patience:
            return False
        self._patience = min(2 * self._patience, MOST_SECONDS)
        self.begin_anew()
        return True
