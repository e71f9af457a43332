# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Log times by simulation time, as `ros2 bag record --use-sim-time` writes them."""
from __future__ import annotations

from collections.abc import Iterable

from bags.cdr_time import first_time
from bags.recorded_topic import RecordedTopic
from bags.recording import Entry


class SimulationTime:
    """
    Gives each message the time that `/clock` said last before it arrived.

    What came before the first clock message gets that one's time.

    Attributes:
        clock: the topic `/clock`.
        now: simulation time in ns; None until somebody has said it.
    """

    def __init__(self, clock: RecordedTopic) -> None:
        """Begin without a time."""
        self.clock = clock
        self.now: int | None = None

    def begin(self, batch: Iterable[Entry]) -> bool:
        """Look for the first clock message; return whether the time is known by now."""
        if self.now is None:
            times = (read_clock(data) for *_, number, data in batch
                     if number == self.clock.number)
            self.now = next((time for time in times if time is not None), None)
        return self.now is not None

    def apply(self, batch: Iterable[Entry]) -> list[Entry]:
        """Return messages, in order of arrival, with simulation time as log time once known."""
        result = []
        for received, sent, number, data in batch:
            if number == self.clock.number:
                time = read_clock(data)
                self.now = self.now if time is None else time
            if number is not None:
                result.append((received if self.now is None else self.now, sent, number, data))
        return result


def read_clock(data: bytes) -> int | None:
    """Return the time of a serialized clock message in ns; None if it is none."""
    time = first_time(data)
    return None if time is None or time < 0 else time
