# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag played as fast as a driver answers: waiting for twists, comparing Q-values."""
from __future__ import annotations

from collections.abc import Mapping
import threading

from bags.cdr_time import first_time
from msgs_bridge.step import Q_VALUE_AXES, Q_VALUE_EXTRAS

# images whose Q-values are known of one side only, and are kept for the other
MOST_WAITING = 1000


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


class Comparison:
    """
    Recorded Q-values beside those of who drives now, by the stamp of their image.

    Attributes:
        compared: decisions that both sides have.
        same: those in which both chose the same action.
        largest: most that a Q-value differs by.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.compared = self.same = 0
        self.largest = 0.0
        self._waiting: tuple[dict[int, Mapping[str, float]], ...] = ({}, {})
        self._lock = threading.Lock()

    def recorded(self, stamp: int, values: Mapping[str, float]) -> None:
        """Take recorded values, as the `q_values` topic names them, of an image's stamp in ns."""
        self._take(0, stamp, values)

    def answered(self, stamp: int, values: Mapping[str, float]) -> None:
        """Take the same of who drives now."""
        self._take(1, stamp, values)

    def text(self) -> str:
        """Return what came of it in words, '' if nothing could be compared."""
        if not self.compared:
            return ''
        return (f'{self.compared} q_values compared: the same action in '
                f'{self.same / self.compared:.1%}, Q-values differ by up to {self.largest:.3g}')

    def _take(self, side: int, stamp: int, values: Mapping[str, float]) -> None:
        with self._lock:
            other = self._waiting[1 - side].pop(stamp, None)
            if other is None:
                waiting = self._waiting[side]
                waiting[stamp] = values
                if len(waiting) > MOST_WAITING:
                    del waiting[min(waiting)]
                return
            self.compared += 1
            self.same += values.get('chosen') == other.get('chosen')
            differences = [abs(value - other[name]) for name, value in values.items()
                           if name in other and name not in {
                               **Q_VALUE_EXTRAS, **Q_VALUE_AXES}]
            self.largest = max([self.largest, *differences])
