# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One car as the trainer sees it: its messages, joined, waiting to be learned from.

Whatever is known of a car and not of the run is here, so that a trainer of several cars has one of
these for each.
"""
from __future__ import annotations

from collections import Counter, deque
import time

import numpy as np

from msgs_bridge.step import Step
from msgs_bridge.topics import STEP
from msgs_bridge.transitions import Transition, TransitionJoiner
from msgs_bridge.twists import Command

# times the queue limit at which transitions are dropped because nobody can be held back
OVERRUN = 50
# the same, for frames that are large
MAX_WAITING_BYTES = 128 * 2**20
# without a transition for so long something is missing; seconds
SILENCE_SECONDS = 1.0
# from this share of lost transitions on something is wrong
LOST_SHARE = 0.1
LEAST_LOST = 10
# what the joiner counts, in words
LOSSES = {
    'no_image': 'no image has ever come', 'no_twist': 'no twist has ever come',
    'lost_image': 'their images are missing', 'lost_twist': 'the twists that were applied to '
    'them are missing', 'lost_step': 'steps between them are missing',
    'unanswered': 'no twist was applied', 'odd_step': 'stamps of step do not follow each other',
}


class Source:
    """
    The joiner of one car and the queue behind it.

    Attributes:
        joiner: joins its messages.
        overrun: transitions that were dropped because the queue was full.
    """

    def __init__(self, queue_limit: int) -> None:
        """Ask to be held back when more than `queue_limit` transitions wait."""
        self.joiner = TransitionJoiner()
        self.overrun = 0
        self._queue_limit = queue_limit
        self._waiting: deque[Transition] = deque()
        self._waiting_bytes = 0
        self._joined_at = self._looked_at = time.monotonic()
        self._seen: Counter[str] = Counter()

    def __len__(self) -> int:
        """Return how many transitions wait."""
        return len(self._waiting)

    def add_image(self, stamp: int, frame: np.ndarray) -> bool:
        """Take a frame, uint8 (H, W, 3), at a stamp in ns; return whether nothing was dropped."""
        return self._put(self.joiner.add_image(stamp, frame))

    def add_step(self, stamp: int, step: Step) -> bool:
        """Take a step at a stamp in ns; return whether nothing was dropped."""
        return self._put(self.joiner.add_step(stamp, step))

    def add_twist(self, stamp: int, command: Command) -> bool:
        """Take a command at the stamp in ns of its frame; return whether nothing was dropped."""
        return self._put(self.joiner.add_twist(stamp, command))

    def _put(self, transitions: list[Transition]) -> bool:
        for number, transition in enumerate(transitions):
            if (len(self._waiting) >= OVERRUN * self._queue_limit
                    or self._waiting_bytes > MAX_WAITING_BYTES):
                self.overrun += len(transitions) - number
                return False
            self._waiting.append(transition)
            self._waiting_bytes += transition.next_frame.nbytes
        if transitions:
            self._joined_at = time.monotonic()
        return True

    def looked(self) -> None:
        """Take note that its messages have been looked for just now."""
        self._looked_at = time.monotonic()

    def take(self) -> Transition | None:
        """Return the next transition, None if none waits."""
        if not self._waiting:
            return None
        transition = self._waiting.popleft()
        self._waiting_bytes -= transition.next_frame.nbytes
        return transition

    def should_hold(self, holding: bool) -> bool:
        """Return whether the simulator is to be held back; `holding` says whether it is now."""
        if holding:
            return len(self._waiting) > self._queue_limit // 4
        return len(self._waiting) > self._queue_limit

    @property
    def silent_topic(self) -> str:
        """Return the topic that is to blame when nothing has been joined for a while, or ''."""
        if self._waiting or self._looked_at - self._joined_at < SILENCE_SECONDS:
            return ''
        return self.joiner.missing or STEP.name

    def losses(self) -> str:
        """Return what is wrong with the transitions since the last call, '' if they are well."""
        # a copy at once, for the learning thread goes on counting
        counts = Counter(dict(self.joiner.counts))
        new, self._seen = counts - self._seen, counts
        lost = Counter({name: new[name] for name in LOSSES if new[name]})
        total = sum(lost.values())
        if total < LEAST_LOST or total < LOST_SHARE * (total + new['joined']):
            return ''
        (name, _), = lost.most_common(1)
        return f'{total} of {total + new["joined"]} transitions are lost: {LOSSES[name]}'

    def figures(self) -> dict[str, float]:
        """Return its figures, for the diagnostics."""
        return {
            'waiting': len(self._waiting), 'image_bytes': self.joiner.held_bytes,
            'transitions_overrun': self.overrun, **{
                f'transitions_{name}': count for name, count in dict(self.joiner.counts).items()
                if count}}
