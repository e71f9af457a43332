# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Waits for the twist that answers an image, so that a bag plays as fast as a driver answers."""
from __future__ import annotations

import threading

from bags.cdr_time import first_time


class Answers:
    """
    Keeps the player from running ahead of the driver.

    Attributes:
        missing: images that no twist answered in time.
    """

    def __init__(self, seconds: float) -> None:
        """Wait at most so many seconds for each answer."""
        self.missing = 0
        self._seconds = seconds
        self._expected: int | None = None
        self._stopped = False
        self._change = threading.Condition()

    def expect(self, image: bytes) -> None:
        """Await the answer to a serialized image that is about to be published."""
        with self._change:
            self._expected = first_time(image)

    def take(self, twist: bytes) -> None:
        """Take a serialized stamped twist from whoever drives."""
        with self._change:
            if self._expected is not None and first_time(twist) == self._expected:
                self._expected = None
                self._change.notify_all()

    def wait(self) -> None:
        """Wait for the answer; a missing one is counted."""
        with self._change:
            if not self._change.wait_for(
                    lambda: self._expected is None or self._stopped, self._seconds):
                self.missing += 1
            self._expected = None

    def stop(self) -> None:
        """End a wait, and let no other begin."""
        with self._change:
            self._stopped = True
            self._change.notify_all()
