# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Transitions joined by stamp from three topics, never by order of arrival.

`step` is the spine: two neighbouring step messages of one episode make a transition when both
images and the twist that was applied in between are there. Within one topic messages arrive in
order, so a topic that has gone past a stamp will not deliver it any more: that transition is
dropped and counted, and no other is touched.
"""
from __future__ import annotations

from collections import Counter, deque, OrderedDict
import dataclasses

import numpy as np

from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import Step
from msgs_bridge.twists import Command


@dataclasses.dataclass(frozen=True)
class Transition:
    """
    One decision and what came of it.

    Attributes:
        stamp, next_stamp: simulation time of the two frames in ns; the next transition of the
            same unbroken stretch has this `next_stamp` as its `stamp`.
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


class _Lane:
    """What one topic has delivered and nobody has used up yet, by stamp."""

    def __init__(self, capacity: int) -> None:
        self.items: OrderedDict[int, object] = OrderedDict()
        self.newest = -1
        self.capacity = capacity

    def put(self, stamp: int, item: object) -> bool:
        """Keep an item; return False for a stamp that is there already."""
        if stamp in self.items:
            return False
        self.items[stamp] = item
        self.newest = max(self.newest, stamp)
        if len(self.items) > self.capacity:
            self.items.popitem(last=False)
        return True

    def forget_before(self, stamp: int) -> None:
        """Drop what is older than a stamp."""
        while self.items and next(iter(self.items)) < stamp:
            self.items.popitem(last=False)


class TransitionJoiner:
    """
    Joins images, steps and twists into transitions.

    Feed it with `add_image`, `add_step` and `add_twist` in any order across topics; each returns
    the transitions that have become complete, in order of time. `counts` says how many were
    joined and why others were dropped: `duplicate`, `unanswered` (no twist was applied),
    `lost_image`, `lost_twist`, `lost_step`, `rewound` (time went back, as when a bag loops).
    """

    def __init__(self, capacity: int = 4096) -> None:
        """Bound what is kept to `capacity` messages a topic."""
        self._images = _Lane(capacity)
        self._twists = _Lane(capacity)
        self._steps: deque[tuple[int, Step]] = deque()
        self._newest_step = -1
        self._capacity = capacity
        self.counts: Counter[str] = Counter()

    def add_image(self, stamp: int, frame: np.ndarray) -> list[Transition]:
        """Take an image, uint8 (H, W, 3), at a stamp in ns."""
        self.counts['duplicate'] += not self._images.put(stamp, frame)
        return self._join()

    def add_twist(self, stamp: int, command: Command) -> list[Transition]:
        """Take the command that answers the image of a stamp in ns."""
        self.counts['duplicate'] += not self._twists.put(stamp, command)
        return self._join()

    def add_step(self, stamp: int, step: Step) -> list[Transition]:
        """
        Take the step of the image of a stamp in ns.

        A stamp older than the one before means that time was set back: what was kept is dropped.
        """
        if stamp == self._newest_step:
            self.counts['duplicate'] += 1
            return []
        if stamp < self._newest_step:
            self._rewind()
        self._newest_step = stamp
        self._steps.append((stamp, step))
        if len(self._steps) > self._capacity:
            self._steps.popleft()
            self.counts['lost_image'] += 1
        return self._join()

    def _rewind(self) -> None:
        """Start anew after time went back: nothing across the break is joined."""
        self.counts['rewound'] += 1
        self._images.__init__(self._capacity)
        self._twists.__init__(self._capacity)
        self._steps.clear()

    def _join(self) -> list[Transition]:
        joined = []
        while len(self._steps) > 1:
            (stamp, before), (next_stamp, after) = self._steps[0], self._steps[1]
            verdict = self._verdict(stamp, before, next_stamp, after)
            if verdict == 'wait':
                break
            if isinstance(verdict, Transition):
                joined.append(verdict)
                verdict = 'joined'
            if verdict != 'boundary':
                self.counts[verdict] += 1
            self._steps.popleft()
            self._images.forget_before(next_stamp)
            # a held twist may be applied to later frames, so twists are kept for one second
            self._twists.forget_before(next_stamp - NANOSECONDS)
        return joined

    def _verdict(
        self, stamp: int, before: Step, next_stamp: int, after: Step,
    ) -> Transition | str:
        if before.episode != after.episode or after.decision == 0:
            return 'boundary'
        if after.decision != before.decision + 1:
            return 'lost_step'
        if after.applied is None:
            return 'unanswered'
        for lane, wanted, loss in (
            (self._images, stamp, 'lost_image'),
            (self._images, next_stamp, 'lost_image'),
            (self._twists, after.applied, 'lost_twist'),
        ):
            if wanted not in lane.items:
                return loss if lane.newest > wanted else 'wait'
        return Transition(
            stamp, next_stamp, self._images.items[stamp], self._images.items[next_stamp],
            self._twists.items[after.applied], after, before,
        )
