# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The clock of a playback: when which message is due, with pause, step, rate and `/clock`."""
from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
import threading
import time

import numpy as np

from bags.messages import BagMessage

NANOSECONDS = 1e9
# A sleep wakes some 60 us late; a wait that can be interrupted some 100 us later still.
LAST_SLEEP = 0.002
# seconds; a lock takes no more than some 300 years
LONGEST_WAIT = 3600.0
# what a person chooses from: speeds, and by how much of the bag to go back or on
RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 20.0)
SKIP_SECONDS = 5.0
# A bag may be played for days; this much tells how well the time was kept lately.
LATE_KEPT = 100_000


class Playback:
    """
    Calls `publish` for every message when it is due.

    Attributes:
        played: messages published.
        late: seconds from due to published, of the newest messages that were paced.
        latest: the most it ever was.
        now: time of the bag in ns.
        due: wall time, as `time.monotonic` has it, at which the next message is due; None if it
            does not wait for it.
    """

    def __init__(
        self,
        publish: Callable[[BagMessage], None],
        *,
        rate: float = 1.0,
        paused: bool = False,
        publish_clock: Callable[[int], None] | None = None,
        clock_rate: float = 0.0,
    ) -> None:
        """
        Prepare; nothing is played yet.

        Args:
            publish: takes a message that is due.
            rate: speed; 0 = as fast as `publish` takes them.
            paused: whether to wait for `pause(False)` or `step()`.
            publish_clock: takes the time of the bag in ns.
            clock_rate: how often a second of wall time.
        """
        self.played = 0
        self.late: deque[float] = deque(maxlen=LATE_KEPT)
        self.latest = 0.0
        self.now = 0
        self.due: float | None = None
        self._publish = publish
        self._publish_clock = publish_clock if clock_rate > 0 else None
        self._clock_seconds = 1 / clock_rate if clock_rate > 0 else LONGEST_WAIT
        self._wait_seconds = min(self._clock_seconds, LONGEST_WAIT)
        self._rate = rate
        self._paused = paused
        self._held = False
        self._steps = 0
        self._stopped = False
        self._wound_to: int | None = None
        self._change = threading.Condition()
        # wall time and time of the bag that belong together; set when playing begins or goes on
        self._anchor: tuple[float, int] | None = None
        self._next_tick = 0.0

    @property
    def paused(self) -> bool:
        """Return whether it waits for `pause(False)` or `step()`."""
        return self._paused

    @property
    def held(self) -> bool:
        """Return whether a slow listener holds it back."""
        return self._held

    @property
    def rate(self) -> float:
        """Return the speed; 0 = as fast as messages are taken."""
        return self._rate

    @property
    def unpaced(self) -> bool:
        """Return whether messages go out as fast as they are taken."""
        return self._rate == 0

    def play(self, messages: Iterable[BagMessage]) -> None:
        """Play messages in their order until they end, or `stop` or `wind` is called."""
        self._anchor = None
        for message in messages:
            due = self._wait_until(message.log_time)
            if self._stopped or self._wound_to is not None:
                return
            self.now = message.log_time
            if due is not None:
                late = time.monotonic() - due
                self.late.append(late)
                self.latest = max(self.latest, late)
            self._publish(message)
            self.played += 1

    def pause(self, paused: bool) -> None:
        """Pause or go on."""
        with self._change:
            self._paused = paused
            self._anchor = None
            self._change.notify_all()

    def hold(self, held: bool) -> None:
        """Wait for a slow listener, whether paused or not; not even a step goes through."""
        with self._change:
            self._held = held
            self._anchor = None
            self._change.notify_all()

    def step(self) -> bool:
        """Let one message through while paused; return whether it was paused."""
        with self._change:
            if not self._paused:
                return False
            self._steps += 1
            self._change.notify_all()
            return True

    def set_rate(self, rate: float) -> None:
        """Go on at another speed."""
        with self._change:
            if rate != self._rate:
                self._rate = rate
                self._anchor = None
                self._change.notify_all()

    def wind(self, place: int) -> None:
        """End `play` before its next message; `wound` tells its caller to go on at a place."""
        with self._change:
            self._wound_to = self.now = place
            self._change.notify_all()

    def wound(self) -> int | None:
        """Return the time of the bag in ns to go on at, None if it was not wound since."""
        with self._change:
            place, self._wound_to = self._wound_to, None
            return place

    def stop(self) -> None:
        """End `play` before the next message."""
        with self._change:
            self._stopped = True
            self._change.notify_all()

    def timing_error(self, newest: int = LATE_KEPT) -> tuple[float, float, float]:
        """Return p50 and p99 of how late the newest messages were, and the maximum; seconds."""
        # a copy in one piece: a deque must not grow while somebody goes through it
        late = np.array(self.late.copy())[-newest:]
        if not late.size:
            return 0.0, 0.0, 0.0
        middle, worst = np.percentile(late, (50, 99))
        return float(middle), float(worst), self.latest

    def _wait_until(self, log_time: int) -> float | None:
        """Wait until a message is due; return the wall time it was due at, None if unpaced."""
        while True:
            with self._change:
                self.due = None
                if self._stopped or self._wound_to is not None:
                    return None
                if self._paused or self._held:
                    if self._steps and not self._held:
                        self._steps -= 1
                        return None
                    self._change.wait(self._wait_seconds)
                    self._tick(self.now)
                    continue
                if self._rate == 0:
                    self._tick(log_time)
                    return None
                if self._anchor is None:
                    # what was due when the pace changed is due now
                    self._anchor = (time.monotonic(), self.now or log_time)
                wall, bag = self._anchor
                due = wall + (log_time - bag) / NANOSECONDS / self._rate
                rest = due - time.monotonic()
                if rest > LAST_SLEEP:
                    self.due = due
                    self._change.wait(min(rest - LAST_SLEEP / 2, self._wait_seconds))
                    # a busy machine wakes late, but a clock that is ahead would have to go back
                    self._tick(min(self._time_at(time.monotonic()), log_time))
                    continue
            if rest > 0:
                time.sleep(rest)
            self._tick(log_time)
            return due

    def _time_at(self, wall: float) -> int:
        """Return the time of the bag at a wall time."""
        if self._anchor is None:
            return self.now
        return self._anchor[1] + round((wall - self._anchor[0]) * self._rate * NANOSECONDS)

    def _tick(self, bag_time: int) -> None:
        """Publish the time of the bag if it is due again; paused, it stands but is published."""
        if self._publish_clock is None or bag_time == 0:
            return
        wall = time.monotonic()
        if wall >= self._next_tick:
            # a tick that was missed is not made up for
            self._next_tick = max(self._next_tick + self._clock_seconds,
                                  wall + self._clock_seconds / 2)
            self._publish_clock(bag_time)


def next_rate(rate: float, direction: int) -> float:
    """Return the next of `RATES` above a speed (direction 1) or below it (-1)."""
    above = (one for one in RATES if rate and one > rate)
    below = (one for one in RATES if not rate or one < rate)
    return min(above, default=rate) if direction > 0 else max(below, default=rate)
