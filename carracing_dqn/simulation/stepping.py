# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
When a simulator goes on: by the twist that answers its frame, or by the wall clock. Without ROS.

Whatever comes in which order, what goes out is a stream: stamps rise, decisions count up by one,
and every episode begins and ends once.
"""
from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
import time
from typing import Protocol

from carracing_dqn.simulation.drive import Drive, Frame
from carracing_dqn.simulation.settings import SimulationSettings
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.twists import Command, STOP

# With plain twists, how long after one answer another may still come that is on its way: so many
# times as long as the driver has taken, of which no more than these seconds count.
STRAGGLING = 2.0
LONGEST_STRAGGLING = 5.0
# and how long, at least, nothing may come before it is believed that no more is on its way
QUIET_SECONDS = 0.05
NOT_STARTED = 'not started: nobody drives yet'
OVER = 'all episodes are driven'


class Outlet(Protocol):
    """
    Where the stream goes: the node.

    Attributes:
        settings: as they are now; some may change while the node runs.
        counts: events, for the diagnostics.
    """

    settings: SimulationSettings
    counts: Counter[str]

    def send_frame(self, frame: Frame) -> None:
        """Publish a new frame."""

    def send_again(self, frame: Frame) -> None:
        """Publish the image of a frame once more."""

    def send_episode(self, values: dict[str, float], stamp: int) -> None:
        """Publish that an episode has ended without a last frame."""

    def warn(self, text: str) -> None:
        """Tell people, but not too often."""


class Stepping(ABC):
    """
    What both ways share: pauses, single steps, resets and the end.

    Attributes:
        frame: the newest one that was sent; None before the first.
        held_back: whether a learner holds the simulator back.
        paused: whether people do.
        decisions, simulated: published and simulated frames since the start.
    """

    def __init__(
        self, drive: Drive, outlet: Outlet, now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Stand still until `start`; `now` is the wall clock in seconds."""
        self.drive = drive
        self.frame: Frame | None = None
        self.held_back = False
        self.paused = outlet.settings.start_paused
        self.decisions = self.simulated = 0
        self._outlet = outlet
        self._now = now
        self._over = False
        self._steps_allowed = 0

    @property
    def finished(self) -> bool:
        """Return whether the last episode asked for has ended and been sent."""
        return self._over

    def start(self) -> None:
        """Begin the first episode."""
        self._begin()

    @abstractmethod
    def take(self, command: Command, stamp: int | None) -> None:
        """
        Take a twist.

        Args:
            command: within [-1, 1].
            stamp: its stamp in ns, None for a plain Twist.

        Raises:
            MessageError: a twist that means nothing here.
        """

    @abstractmethod
    def beat(self) -> None:
        """Do what the time has come for; to be called often, in real time at its own rate."""

    def pause(self, paused: bool) -> str:
        """Stand, or go on; return what is so now."""
        self.paused = paused
        self._steps_allowed = 0
        if not paused:
            self._go_on()
        return 'paused' if paused else 'running'

    def hold(self, held_back: bool) -> None:
        """Be held back by a learner, or let go."""
        self.held_back = held_back
        if not held_back:
            self._go_on()

    def step(self) -> tuple[bool, str]:
        """Allow one decision while paused; return whether it is, and what comes of it."""
        if not self.paused:
            return False, 'not paused: call ~/pause with true first'
        if self.frame is None or self._over:
            return False, OVER if self._over else NOT_STARTED
        before = self.decisions
        self._steps_allowed += 1
        self._go_on()
        if self.decisions > before:
            return True, f'episode {self.drive.episode}, decision {self.drive.decision}'
        return True, (f'{self._steps_allowed} step{"s" if self._steps_allowed > 1 else ""} to go '
                      f'as soon as {self._awaits()}')

    def reset(self) -> tuple[bool, str]:
        """End the episode where it is and begin the next; return whether, and which."""
        if self.frame is None or self._over:
            return False, OVER if self._over else NOT_STARTED
        left = self.drive.abandon()
        if left is not None:
            self._send_end(left, self.drive.stamp)
        self._begin()
        return True, OVER if self._over else f'episode {self.drive.episode}'

    def _awaits(self) -> str:
        """Return what has to happen before the next decision, in words."""
        return 'no learner holds it back' if self.held_back else 'its time has come'

    @abstractmethod
    def _go_on(self) -> None:
        """Do what a pause or a hold has put off."""

    def _begin(self) -> None:
        if self.drive.finished:
            self._over = True
        else:
            self._send(self.drive.begin())

    def _advance(self, command: Command, stamp: int | None) -> None:
        """Drive one decision, and begin the next episode after the last frame of one."""
        frame = self.drive.advance(command, stamp)
        self.decisions += 1
        self.simulated += frame.step.info['frames']
        self._send(frame)
        if frame.step.ended:
            self._begin()

    def _send(self, frame: Frame) -> None:
        self.frame = frame
        self._outlet.send_frame(frame)

    def _send_end(self, values: dict[str, float], stamp: int) -> None:
        self._outlet.send_episode(values, stamp)

    def _may_step(self) -> bool:
        if self.held_back or self._over:
            return False
        if not self.paused:
            return True
        if self._steps_allowed:
            self._steps_allowed -= 1
            return True
        return False


class RealTime(Stepping):
    """Goes on by the wall clock, by the last twist as long as it is not stale."""

    def __init__(
        self, drive: Drive, outlet: Outlet, now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Hold no twist."""
        super().__init__(drive, outlet, now)
        self._held: tuple[Command, int] | None = None
        self._held_since = 0.0

    def take(self, command: Command, stamp: int | None) -> None:
        """Hold a twist; a plain one counts as an answer to the newest frame."""
        if self.frame is not None:
            self._held = command, self.frame.stamp if stamp is None else stamp
            self._held_since = self._now()

    def beat(self) -> None:
        """Drive one decision."""
        if self.frame is None or not self._may_step():
            return
        if self._held is None:
            self._advance(STOP, None)
            return
        stale_after = self._outlet.settings.stale_after
        if self._now() - self._held_since > stale_after:
            self._held = None
            self._outlet.counts['stale_twists'] += 1
            self._outlet.warn(f'no twist for {stale_after:g} s: coasting')
            self._advance(STOP, None)
            return
        command, stamp = self._held
        # a stamp of zero says none, as everywhere in ROS: no image has it
        self._advance(command, stamp or None)

    def _begin(self) -> None:
        # a twist for one scene drives in no other
        self._held = None
        super()._begin()

    def _go_on(self) -> None:
        """Leave it to the next beat."""


class Lockstep(Stepping):
    """
    Waits for the twist that answers the newest frame.

    A stamped twist says which frame it answers. A plain one does not: it answers what was sent
    first of what is not answered yet. So after a frame that was sent again, and after the last
    one of an episode, nothing new is sent while answers may be on their way.
    """

    def __init__(
        self, drive: Drive, outlet: Outlet, now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Wait for nothing yet."""
        super().__init__(drive, outlet, now)
        self._answer: tuple[Command, int] | None = None
        self._held: tuple[Command, int] | None = None
        self._final_stamp = -1
        self._asked_at = 0.0
        self._plain = not outlet.settings.cmd_vel_stamped
        # with plain twists: how many images were sent and not answered, and what goes out after
        self._unanswered = 0
        self._first_asked_at = 0.0
        self._patient_until = 0.0
        self._put_off: deque[Callable[[], None]] = deque()

    @property
    def finished(self) -> bool:
        """Return whether the last episode asked for has ended and been sent."""
        return self._over and not self._put_off

    @property
    def late(self) -> bool:
        """Return whether an answer is overdue."""
        return (self.frame is not None and self._answer is None and not self._over
                and self._now() - self._asked_at > self._outlet.settings.answer_timeout)

    @property
    def unanswered(self) -> bool:
        """Return whether an answer is overdue or was so before the frame was sent again."""
        return self.late or (self.frame is not None and self._answer is None and not self._over
                             and self._unanswered > 1)

    def take(self, command: Command, stamp: int | None) -> None:
        """Go on by a twist that answers the newest frame; the first answer counts."""
        if self.frame is None or self.finished:
            return
        if stamp is None:
            if not self._is_answer():
                return
            stamp = self.frame.stamp
        elif stamp != self.frame.stamp:
            # an answer to the last frame of an episode, or a watchdog's zero twist, is no fault
            if stamp == self._final_stamp or stamp == 0 and command == STOP:
                return
            raise MessageError(
                f'twist answers {stamp / NANOSECONDS:.2f} s; '
                f'waiting for {self.frame.stamp / NANOSECONDS:.2f} s')
        if self._answer is None:
            self._held = self._answer = command, stamp
        self._go_on()

    def beat(self) -> None:
        """Do as `on_timeout` says when nobody has answered in time."""
        if self._put_off:
            if self._now() > self._patient_until:
                self._send_put_off()
            return
        if self.held_back or not self.late or self.paused and not self._steps_allowed:
            return
        settings = self._outlet.settings
        self._outlet.counts['answer_timeouts'] += 1
        self._outlet.warn(
            f'no twist on cmd_vel has answered the frame of {self.frame.stamp / NANOSECONDS:.2f} '
            f's for {settings.answer_timeout:g} s; on_timeout: {settings.on_timeout}')
        if settings.on_timeout == 'resend':
            self._asked_at = self._now()
            self._unanswered += 1
            self._outlet.send_again(self.frame)
        elif self._may_step():
            self._advance(*(self._held if settings.on_timeout == 'hold' and self._held
                            else (STOP, None)))

    def step(self) -> tuple[bool, str]:
        """Allow one decision while paused; from now on its answer may be late."""
        if self.paused:
            self._asked_at = self._now()
        return super().step()

    def pause(self, paused: bool) -> str:
        """Stand, or go on; standing does not count as time without an answer."""
        if not paused:
            self._asked_at = self._now()
        return super().pause(paused)

    def hold(self, held_back: bool) -> None:
        """Be held back, or let go; that does not count as time without an answer."""
        if not held_back:
            self._asked_at = self._now()
        super().hold(held_back)

    def reset(self) -> tuple[bool, str]:
        """Begin the next episode."""
        if self.frame is not None:
            # whose answer may be on its way
            self._final_stamp = self.frame.stamp
        return super().reset()

    def _begin(self) -> None:
        # what was answered before means nothing any more
        self._answer = self._held = None
        super()._begin()

    def _awaits(self) -> str:
        return super()._awaits() if self.held_back else 'a twist answers'

    def _go_on(self) -> None:
        if self._answer is not None and self._may_step():
            answer, self._answer = self._answer, None
            self._advance(*answer)

    def _send(self, frame: Frame) -> None:
        if frame.step.ended:
            self._final_stamp = frame.stamp
        if self._plain and (self._put_off or self._unanswered):
            self._put_off.append(lambda: self._ask(frame))
            self._be_patient()
        else:
            self._ask(frame)

    def _send_end(self, values: dict[str, float], stamp: int) -> None:
        if self._put_off:
            self._put_off.append(lambda: self._outlet.send_episode(values, stamp))
        else:
            super()._send_end(values, stamp)

    def _ask(self, frame: Frame) -> None:
        self._asked_at = self._first_asked_at = self._now()
        self._unanswered = 1
        super()._send(frame)

    def _is_answer(self) -> bool:
        """Return whether a plain twist answers the newest frame, and not one before."""
        surplus = self._unanswered == 0
        self._outlet.counts['surplus_twists'] += surplus
        self._unanswered -= not surplus
        if not self._put_off:
            return not surplus
        self._be_patient()
        return False

    def _be_patient(self) -> None:
        """Wait for answers that may be on their way, by how long the driver has taken so far."""
        now = self._now()
        timeout = self._outlet.settings.answer_timeout
        taken = now - self._first_asked_at
        if self._unanswered:
            wait = STRAGGLING * min(max(timeout, taken), max(timeout, LONGEST_STRAGGLING))
        else:
            # all are in, unless more were on their way than we know of
            wait = min(max(QUIET_SECONDS, STRAGGLING * taken), timeout)
        self._patient_until = now + wait

    def _send_put_off(self) -> None:
        # what has not come by now was never to come
        self._unanswered = 0
        while self._put_off and not self._unanswered:
            self._put_off.popleft()()
        if self._put_off:
            self._be_patient()
