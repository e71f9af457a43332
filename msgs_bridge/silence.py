# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How long nothing has come of a stream, and whether its reader should be tried anew."""
from __future__ import annotations

import math
import time

# After so much silence a stream is listened to anew although nothing was lost; each time in a
# silence that goes on, as in a pause, after twice as long.
SILENT_SECONDS, MOST_SILENT_SECONDS = 2.0, 60.0


class Silence:
    """Measures the silence of one stream by wall time; one that was never heard is not missed."""

    def __init__(self) -> None:
        """Begin now."""
        self._since = time.monotonic()
        self._patience = math.inf

    @property
    def seconds(self) -> float:
        """Return how long it is since a message came or the reader was made anew."""
        return time.monotonic() - self._since

    def end(self) -> None:
        """Note that a message has come."""
        self._since = time.monotonic()
        self._patience = SILENT_SECONDS

    def begin_anew(self) -> None:
        """Note that the reader was made anew."""
        self._since = time.monotonic()

    def too_long(self) -> bool:
        """Return whether to make the reader anew, and wait twice as long for the next time."""
        if self.seconds <= self._patience:
            return False
        self._patience = min(2 * self._patience, MOST_SILENT_SECONDS)
        self.begin_anew()
        return True
