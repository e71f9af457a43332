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
"""
from __future__ import annotations

from collections import Counter, deque
import dataclasses
import heapq
from typing import Any

import numpy as np

from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import Step
from msgs_bridge.topics import CMD_VEL, IMAGE, STEP
from msgs_bridge.twists import Command

# simulated time from a message of a topic to the next one; held commands last a minute at most
REACH = 600 * NANOSECONDS
# a twist may be applied to frames that come later than the one it answers
TWIST_KEPT = NANOSECONDS
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

    def __len__(self) -> int:
        return len(self._items)

    def __contains__(self, stamp: int) -> bool:
        return stamp in self._items

    def __getitem__(self, stamp: int) -> Any:
        return self._items[stamp][0]

    def put(self, stamp: int, item: Any, size: int, *, newest: bool = False) -> bool:
        """
        Keep an item of so many bytes; return False for a stamp that is there already.

        Args:
            stamp: of the message.
            item: what is kept of it.
            size: its bytes.
            newest: whether it takes the place of one that is there.
        """
        self.heard += 1
        if self._position.move(stamp) == 'moved':
            # what is ahead was left behind by the time before
            self.forget_from(stamp)
        if stamp in self._items:
            if newest:
                self.held_bytes += size - self._items[stamp][1]
                self._items[stamp] = item, size
                self._trim()
            return False
        self._items[stamp] = item, size
        self.held_bytes += size
        if len(self._oldest) > 2 * len(self._items) + 64:
            self._oldest = sorted(self._items)
        else:
            heapq.heappush(self._oldest, stamp)
        self._trim()
        return True

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

    def forget_from(self, stamp: int) -> None:
        """Drop what is of a stamp or newer."""
        for other in [other for other in self._items if other >= stamp]:
            self._drop(other)

    def has_passed(self, stamp: int) -> bool:
        """Return whether a message of a stamp will not come any more."""
        return self._position.stamp is not None and self._position.stamp > stamp

    def set_back(self, stamp: int) -> None:
        """Expect messages from a stamp on again."""
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


class TransitionJoiner:
    """
    Joins images, steps and twists of one car into transitions.

    Feed it with `add_image`, `add_step` and `add_twist` in any order across topics; each returns
    the transitions that have become complete, in order of time.

    Attributes:
        counts: how many were `joined`, and why others were dropped: `duplicate` messages,
            `unanswered` (no twist was applied), `lost_image`, `lost_twist`, `lost_step` (how many
            steps are missing), `odd_step` (a stamp that nothing followed), `no_image` and
            `no_twist` (nothing of that topic has ever come), `rewound` (time went back, as when a
            bag loops).
    """

    def __init__(
        self, capacity: int = MAX_MESSAGES, image_bytes: int = MAX_IMAGE_BYTES,
    ) -> None:
        """Bound what is kept to so many messages a topic, and to so many bytes of images."""
        self._images = _Lane(image_bytes, capacity)
        self._twists = _Lane(image_bytes, capacity)
        self._steps: deque[tuple[int, Step]] = deque()
        self._position = _Position()
        self._doubted: tuple[int, Step] | None = None
        self._capacity = capacity
        self._waits_for = ''
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
        # one that is sent again is the same, unless the simulator has been started again
        if not self._images.put(stamp, frame, frame.nbytes, newest=True):
            self.counts['duplicate'] += 1
        return self._join()

    def add_twist(self, stamp: int, command: Command) -> list[Transition]:
        """Take the command that answers the image of a stamp in ns."""
        # of two answers to one frame the first is the one that was applied
        if not self._twists.put(stamp, command, 0):
            self.counts['duplicate'] += 1
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
                self._steps[-1] = stamp, step
            return []
        doubted, self._doubted = self._doubted, (stamp, step) if how == 'doubted' else None
        if how == 'moved':
            if stamp < before:
                self._rewind(doubted[0])
            self._steps.append(doubted)
        elif doubted is not None:
            self.counts['odd_step'] += 1
        if how != 'doubted':
            self._steps.append((stamp, step))
        while len(self._steps) > self._capacity:
            self._steps.popleft()
            self.counts[self._named(
                'lost_twist' if self._waits_for == CMD_VEL.name else 'lost_image')] += 1
        return self._join()

    def _named(self, loss: str) -> str:
        """Return the name of a loss: that of a topic of which nothing has come is the cause."""
        for name, lane in (('image', self._images), ('twist', self._twists)):
            if not lane.heard:
                return f'no_{name}'
        return loss

    def _rewind(self, start: int) -> None:
        """Start anew at a stamp after time went back: nothing across the break is joined."""
        self.counts['rewound'] += 1
        front = self._steps[0][0] if self._steps else start
        self._steps.clear()
        # what came before the break is at least as new as the spine was; the rest is of after it
        self._images.forget_from(front)
        self._twists.forget_from(front - TWIST_KEPT)
        for lane in (self._images, self._twists):
            lane.set_back(start)

    def _join(self) -> list[Transition]:
        joined = []
        self._waits_for = ''
        while len(self._steps) > 1:
            (stamp, before), (next_stamp, after) = self._steps[0], self._steps[1]
            verdict = self._verdict(stamp, before, next_stamp, after)
            if verdict == 'wait':
                break
            if isinstance(verdict, Transition):
                joined.append(verdict)
                verdict = 'joined'
            if verdict in ('lost_image', 'lost_twist'):
                verdict = self._named(verdict)
            if verdict == 'lost_step':
                self.counts[verdict] += missing_steps(before, after)
            elif verdict != 'boundary':
                self.counts[verdict] += 1
            self._steps.popleft()
            self._images.forget_before(next_stamp)
            self._twists.forget_before(next_stamp - TWIST_KEPT)
        return joined

    def _verdict(
        self, stamp: int, before: Step, next_stamp: int, after: Step,
    ) -> Transition | str:
        if missing_steps(before, after):
            return 'lost_step'
        if before.episode != after.episode or after.decision == 0:
            return 'boundary'
        applied = after.applied
        if applied is None:
            return 'unanswered'
        for wanted in (stamp, next_stamp):
            if wanted not in self._images:
                return self._absent(self._images, wanted, IMAGE.name, 'lost_image')
        if applied not in self._twists:
            if applied > next_stamp and not self._twists.has_passed(next_stamp):
                # twists of this clock answer frames that were seen before
                return 'lost_twist'
            return self._absent(self._twists, applied, CMD_VEL.name, 'lost_twist')
        return Transition(
            stamp, next_stamp, self._images[stamp], self._images[next_stamp],
            self._twists[applied], after, before,
        )

    def _absent(self, lane: _Lane, wanted: int, topic: str, loss: str) -> str:
        if lane.has_passed(wanted):
            return loss
        self._waits_for = topic
        return 'wait'
