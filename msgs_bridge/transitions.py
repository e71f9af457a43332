# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Transitions joined by stamp from three topics, never by order of arrival.

`step` is the spine: two neighbouring step messages of one episode make a transition when both
images and the twist that was applied in between are there. Within one topic messages arrive in
order, so a topic that has gone past a stamp will not deliver it any more: that transition is
dropped and counted, and no other is touched.

Nothing on a topic can be trusted to be in order, though. So one message alone never moves a topic
in time, far ahead or back: it takes two that follow each other, as when a bag loops or a simulator
starts again. An odd one costs the transitions that it stands in the way of, and no later ones.

Of several twists with one stamp a simulator in lockstep applies the first and one in real time the
last. What is learned from is the one that `step` says was applied (`linear` and `angular`). Where
it does not say, or where images or steps of one stamp differ, as when two publish a topic, nothing
tells what happened: such a transition is dropped and counted.
"""
from __future__ import annotations

from collections import Counter, deque
import dataclasses
import heapq
from typing import Any, NamedTuple

import numpy as np

from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import Step
from msgs_bridge.topics import CMD_VEL, IMAGE, STEP
from msgs_bridge.twists import Command

# simulated time from a message of a topic to the next one; held commands last a minute at most
REACH = 600 * NANOSECONDS
# a twist may be applied to frames that come later than the one it answers
TWIST_KEPT = NANOSECONDS
# different twists of one stamp that are kept: the first ones and the last
MOST_TWISTS = 8
# by which a twist and what `step` says of it may differ: one may have been a float32
SAID_TOLERANCE = 1e-6
MAX_MESSAGES = 4096
MAX_IMAGE_BYTES = 64 * 2**20


@dataclasses.dataclass(frozen=True)
class Transition:
    """
    One decision and what came of it.

    Attributes:
        stamp, next_stamp: simulation time of the two frames in ns; the next transition of the
            same trajectory segment has this `next_stamp` as its `stamp`.
        frame, next_frame: uint8 (H, W, 3) rgb.
        command: what the twist said.
        step: what came of it, the step of the next frame.
        previous: the step of the first frame.
    """

    stamp: int
    next_stamp: int
    frame: np.ndarray
    next_frame: np.ndarray
    command: Command
    step: Step
    previous: Step

    @property
    def terminated(self) -> bool:
        """Return whether the episode ended by its rules: nothing comes after."""
        return self.step.terminated

    @property
    def truncated(self) -> bool:
        """Return whether the episode was cut off: more would have come."""
        return self.step.truncated


class _Position:
    """
    Where a topic is in time, moved by two stamps that follow each other and never by one alone.

    Attributes:
        stamp: of the newest message that is believed; None before the first.
    """

    def __init__(self) -> None:
        self.stamp: int | None = None
        self._doubted: int | None = None

    def move(self, stamp: int) -> str:
        """
        Take note of a message.

        Returns:
            `on` for one that follows, `again` for the newest one's stamp, `doubted` for one that
            is far ahead or behind, `moved` for one that follows such a one.
        """
        if stamp == self.stamp:
            return 'again'
        doubted, self._doubted = self._doubted, None
        if self.stamp is None or _follows(stamp, self.stamp):
            self.stamp = stamp
            return 'on'
        if doubted is not None and _follows(stamp, doubted):
            self.stamp = stamp
            return 'moved'
        self._doubted = stamp
        return 'doubted'


def _follows(stamp: int, other: int) -> bool:
    return 0 < stamp - other <= REACH


class _Lane:
    """
    What one topic has delivered and nobody has used up yet, by stamp.

    Attributes:
        heard: messages that came.
        held_bytes: what is kept.
    """

    def __init__(self, max_bytes: int, max_messages: int) -> None:
        self.heard = 0
        self.held_bytes = 0
        self._max_bytes, self._max_messages = max_bytes, max_messages
        # in the order they came; the heap says which are the oldest by stamp
        self._items: dict[int, tuple[Any, int]] = {}
        self._oldest: list[int] = []
        self._position = _Position()
        self._left: set[int] = set()

    def __len__(self) -> int:
        return len(self._items)

    def __contains__(self, stamp: int) -> bool:
        return stamp in self._items

    def __getitem__(self, stamp: int) -> Any:
        return self._items[stamp][0]

    def hear(self, stamp: int) -> Any | None:
        """Take note of a message; return what is kept of its stamp, None for nothing."""
        self.heard += 1
        if self._position.move(stamp) == 'moved':
            # what is ahead was left behind by the time before, unless somebody else sends it
            ahead = {other for other in self._items if other >= stamp}
            self._left = (self._left | ahead if len(self._left) < self._max_messages else ahead)
            self.forget_from(stamp)
        return self._items.get(stamp, (None,))[0]

    def had_another(self, stamp: int) -> bool:
        """Return whether there was something of a stamp that was left behind."""
        return stamp in self._left

    def put(self, stamp: int, item: Any, size: int) -> None:
        """Keep an item of so many bytes for a stamp, in place of one that is there."""
        if stamp in self._items:
            self.held_bytes += size - self._items[stamp][1]
            self._items[stamp] = item, size
            self._trim()
            return
        self._items[stamp] = item, size
        self.held_bytes += size
        if len(self._oldest) > 2 * len(self._items) + 64:
            self._oldest = sorted(self._items)
        else:
            heapq.heappush(self._oldest, stamp)
        self._trim()

    def _trim(self) -> None:
        """Drop what came first until the rest is within the bounds."""
        while self.held_bytes > self._max_bytes or len(self._items) > self._max_messages:
            self._drop(next(iter(self._items)))

    def _drop(self, stamp: int) -> None:
        _, size = self._items.pop(stamp, (None, 0))
        self.held_bytes -= size

    def forget_before(self, stamp: int) -> None:
        """Drop what is older than a stamp."""
        while self._oldest and self._oldest[0] < stamp:
            self._drop(heapq.heappop(self._oldest))
        if self._left:
            self._left = {other for other in self._left if other >= stamp}

    def forget_from(self, stamp: int) -> None:
        """Drop what is of a stamp or newer."""
        for other in [other for other in self._items if other >= stamp]:
            self._drop(other)

    def has_passed(self, stamp: int) -> bool:
        """Return whether a message of a stamp will not come any more."""
        return self._position.stamp is not None and self._position.stamp > stamp

    def set_back(self, stamp: int) -> None:
        """Expect messages from a stamp on again, after what was left behind."""
        self._left.clear()
        if self.has_passed(stamp):
            self._position.stamp = stamp - 1


def missing_steps(before: Step, after: Step) -> int:
    """
    Return how many steps are known to be missing between two that came one after the other.

    Of an episode whose end was not seen nothing says how long it was: these are not in it.
    """
    if before.episode != after.episode or after.decision == 0:
        return after.decision
    # a decision that goes back within its episode is no count, but nothing follows from it
    return max(after.decision - before.decision - 1, 0 if after.decision > before.decision else 1)


class _Image(NamedTuple):
    """The newest frame of a stamp, and whether all of that stamp were the same."""

    frame: np.ndarray
    alone: bool


class _Place(NamedTuple):
    """The newest step of a stamp, and whether all of that stamp said the same."""

    stamp: int
    step: Step
    alone: bool = True


class TransitionJoiner:
    """
    Joins images, steps and twists of one car into transitions.

    Feed it with `add_image`, `add_step` and `add_twist` in any order across topics; each returns
    the transitions that have become complete, in order of time.

    Attributes:
        counts: how many were `joined`, and why others were dropped: `duplicate` messages,
            `unanswered` (no twist was applied), `lost_image`, `lost_twist`, `lost_step` (how many
            steps are missing), `odd_step` (a stamp that nothing followed), `after_end` (a step of
            an episode that had ended), `twofold` (different messages have one stamp, and nothing
            tells which counts), `no_image` and `no_twist` (nothing of that topic has ever come),
            `rewound` (time went back, as when a bag loops).
    """

    def __init__(
        self, capacity: int = MAX_MESSAGES, image_bytes: int = MAX_IMAGE_BYTES,
    ) -> None:
        """Bound what is kept to so many messages a topic, and to so many bytes of images."""
        self._images = _Lane(image_bytes, capacity)
        self._twists = _Lane(image_bytes, capacity)
        self._steps: deque[_Place] = deque()
        self._position = _Position()
        self._doubted: _Place | None = None
        self._capacity = capacity
        self._waits_for = ''
        # whether `step` said of the last transition what its twist says; None if it said nothing
        self._agrees: bool | None = None
        self.counts: Counter[str] = Counter()

    @property
    def missing(self) -> str:
        """Return the topic without which nothing can be joined now, '' if all have come."""
        for topic, heard in ((STEP, self._position.stamp is not None),
                             (IMAGE, self._images.heard), (CMD_VEL, self._twists.heard)):
            if not heard:
                return topic.name
        return self._waits_for

    @property
    def waiting(self) -> int:
        """Return how many steps wait for what is missing."""
        return max(len(self._steps) - 1, 0)

    @property
    def held_bytes(self) -> int:
        """Return how many bytes of images are kept."""
        return self._images.held_bytes

    def add_image(self, stamp: int, frame: np.ndarray) -> list[Transition]:
        """Take an image, uint8 (H, W, 3), at a stamp in ns."""
        before = self._images.hear(stamp)
        alone = True
        if before is not None:
            self.counts['duplicate'] += 1
            # one that is sent again is the same
            alone = before.alone and np.array_equal(before.frame, frame)
        self._images.put(stamp, _Image(frame, alone), frame.nbytes)
        return self._join()

    def add_twist(self, stamp: int, command: Command) -> list[Transition]:
        """Take the command that answers the image of a stamp in ns."""
        before = self._twists.hear(stamp) or ()
        if before:
            self.counts['duplicate'] += 1
        if command not in before:
            self._twists.put(stamp, (*before[:MOST_TWISTS - 1], command), 0)
        return self._join()

    def add_step(self, stamp: int, step: Step) -> list[Transition]:
        """
        Take the step of the image of a stamp in ns.

        Two that follow each other but not the one before mean that time was set: where it went
        back, what was kept is dropped.
        """
        before = self._position.stamp
        how = self._position.move(stamp)
        if how == 'again':
            self.counts['duplicate'] += 1
            if self._steps:
                newest = self._steps[-1]
                self._steps[-1] = _Place(stamp, step, newest.alone and step == newest.step)
            return []
        place = _Place(stamp, step)
        doubted, self._doubted = self._doubted, place if how == 'doubted' else None
        if how == 'moved':
            if stamp < before:
                self._rewind(doubted.stamp)
            self._steps.append(doubted)
        elif doubted is not None:
            self.counts['odd_step'] += 1
        if how != 'doubted':
            self._steps.append(place)
        return self._join()

    def end(self) -> list[Transition]:
        """Take it that nothing more comes: what waits for it is counted as what it is."""
        return self._join(ended=True)

    def _named(self, loss: str) -> str:
        """Return the name of a loss: that of a topic of which nothing has come is the cause."""
        for name, lane in (('image', self._images), ('twist', self._twists)):
            if not lane.heard:
                return f'no_{name}'
        return loss

    def _rewind(self, start: int) -> None:
        """Start anew at a stamp after time went back: nothing across the break is joined."""
        self.counts['rewound'] += 1
        front = self._steps[0].stamp if self._steps else start
        self._steps.clear()
        # what came before the break is at least as new as the spine was; the rest is of after it
        self._images.forget_from(front)
        self._twists.forget_from(front - TWIST_KEPT)
        for lane in (self._images, self._twists):
            lane.set_back(start)

    def _join(self, *, ended: bool = False) -> list[Transition]:
        joined = []
        self._waits_for = ''
        while len(self._steps) > 1:
            before, after = self._steps[0], self._steps[1]
            verdict = self._verdict(before, after)
            if verdict == 'wait':
                if len(self._steps) <= self._capacity and not ended:
                    break
                verdict = 'lost_twist' if self._waits_for == CMD_VEL.name else 'lost_image'
            if isinstance(verdict, Transition):
                joined.append(verdict)
                verdict = 'joined'
            if verdict in ('lost_image', 'lost_twist'):
                verdict = self._named(verdict)
            if verdict == 'lost_step':
                self.counts[verdict] += missing_steps(before.step, after.step)
            elif verdict != 'boundary':
                self.counts[verdict] += 1
            self._steps.popleft()
            self._images.forget_before(after.stamp)
            # one that is held for long is still to be applied
            applied = after.stamp if after.step.applied is None else after.step.applied
            self._twists.forget_before(min(after.stamp - TWIST_KEPT, applied))
        return joined

    def _verdict(self, before: _Place, after: _Place) -> Transition | str:
        if missing_steps(before.step, after.step):
            return 'lost_step'
        if before.step.episode != after.step.episode or after.step.decision == 0:
            return 'boundary'
        if before.step.ended:
            return 'after_end'
        applied = after.step.applied
        if applied is None:
            return 'unanswered'
        for wanted in (before.stamp, after.stamp):
            if wanted not in self._images:
                return self._absent(self._images, wanted, IMAGE.name, 'lost_image')
        if applied not in self._twists:
            if applied > after.stamp and not self._twists.has_passed(after.stamp):
                # twists of this clock answer frames that were seen before
                return 'lost_twist'
            return self._absent(self._twists, applied, CMD_VEL.name, 'lost_twist')
        commands = self._twists[applied]
        said = _said(after.step)
        command = next((one for one in commands if _is(one, said)), commands[0])
        agrees = None if said is None else _is(command, said)
        if agrees is False and self._agrees is not False and not self._twists.has_passed(applied):
            # another one of its stamp may be on its way
            self._waits_for = CMD_VEL.name
            return 'wait'
        self._agrees = agrees
        # a single twist is what was applied, whatever `linear` and `angular` are to a simulator
        single = len(commands) == 1 and not self._twists.had_another(applied)
        if not (single or agrees) or any(
                self._is_twofold(one) for one in (before, after)):
            return 'twofold'
        return Transition(
            before.stamp, after.stamp, self._images[before.stamp].frame,
            self._images[after.stamp].frame, command, after.step, before.step)

    def _is_twofold(self, place: _Place) -> bool:
        """Return whether steps or images of one stamp differ."""
        return not (place.alone and self._images[place.stamp].alone) or (
            self._images.had_another(place.stamp))

    def _absent(self, lane: _Lane, wanted: int, topic: str, loss: str) -> str:
        if lane.has_passed(wanted):
            return loss
        self._waits_for = topic
        return 'wait'


def _said(step: Step) -> Command | None:
    """Return the command that `step` says was applied, None if it does not say."""
    said = [step.info.get(name) for name in Command._fields]
    return None if None in said else Command(*said)


def _is(command: Command, said: Command | None) -> bool:
    """Return whether a twist, clamped, is the command that a simulator says it has applied."""
    return said is not None and all(
        abs(own - other) <= SAID_TOLERANCE for own, other in zip(command.clamped(), said))
