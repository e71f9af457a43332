# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One car as the trainer sees it: its messages, joined, waiting to be learned from.

Whatever is known of a car and not of the run is here, so that a trainer of several cars has one of
these for each. It knows no other car and no ROS.
"""
from __future__ import annotations

from collections import Counter, deque
import time

import numpy as np

from msgs_bridge.step import Step
from msgs_bridge.topics import STEP
from msgs_bridge.transitions import MAX_IMAGE_BYTES, Transition, TransitionJoiner
from msgs_bridge.twists import Command

# times the queue limit at which transitions are dropped because nobody can be held back
OVERRUN = 50
# the same, for frames that are large
MAX_WAITING_BYTES = 128 * 2**20
# of these bytes each of several sources has a part, as if there were so many
SHARE = 8
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
    'after_end': 'their episode had ended',
    'twofold': 'different messages have one stamp, as when two publish a topic',
}


class Source:
    """
    The joiner of one car and the queue behind it.

    Attributes:
        name: namespace of the car; empty for the one car of the trainer's own.
        joiner: joins its messages.
        overrun: transitions that were dropped because the queue was full.
        refused: why nothing is learned from it at the moment, or ''.
        dropped: transitions that were dropped while it was refused.
        lag: seconds that the transition waited that was taken last.
    """

    def __init__(self, queue_limit: int, name: str = '') -> None:
        """Let some times `queue_limit` transitions wait, and drop what comes beyond."""
        self.name = name
        share = SHARE if name else 1
        self._image_bytes = MAX_IMAGE_BYTES // share
        self._max_waiting_bytes = MAX_WAITING_BYTES // share
        self.joiner = TransitionJoiner(image_bytes=self._image_bytes)
        self.overrun = self.dropped = self.taken = 0
        self.refused = ''
        self.lag = 0.0
        self._queue_limit = queue_limit
        self._waiting: deque[tuple[Transition, float]] = deque()
        self._waiting_bytes = 0
        self._joined_at = self._looked_at = self._rate_from = time.monotonic()
        self._rate_taken = 0
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
        if not transitions:
            return True
        self._joined_at = time.monotonic()
        for number, transition in enumerate(transitions):
            if (len(self._waiting) >= OVERRUN * self._queue_limit
                    or self._waiting_bytes > self._max_waiting_bytes):
                self.overrun += len(transitions) - number
                return False
            self._waiting.append((transition, self._joined_at))
            self._waiting_bytes += transition.next_frame.nbytes
        return True

    def looked(self) -> None:
        """Take note that its messages have been looked for just now."""
        self._looked_at = time.monotonic()

    def take(self) -> Transition | None:
        """Return the next transition, None if none waits."""
        if not self._waiting:
            return None
        transition, since = self._waiting.popleft()
        self._waiting_bytes -= transition.next_frame.nbytes
        self.lag = max(self._looked_at - since, 0.0)
        self.taken += 1
        return transition

    def refuse(self, why: str) -> None:
        """Drop what waits; to be called again and again as long as nothing is to be learned."""
        self.refused = why
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._waiting_bytes = 0

    def accept(self) -> None:
        """Learn from what comes from now on; what came may be mixed up."""
        self.refused = ''
        counts = self.joiner.counts
        self.joiner = TransitionJoiner(image_bytes=self._image_bytes)
        self.joiner.counts = counts

    @property
    def silent_topic(self) -> str:
        """Return the topic that is to blame when nothing has been joined for a while, or ''."""
        if self._waiting or self.silent_seconds < SILENCE_SECONDS:
            return ''
        return self.joiner.missing or STEP.name

    @property
    def silent_seconds(self) -> float:
        """Return for how long nothing has been joined."""
        return max(self._looked_at - self._joined_at, 0.0)

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

    def rate(self) -> float:
        """Return the transitions a second that were taken since the last call."""
        now = time.monotonic()
        count, seconds = self.taken - self._rate_taken, max(now - self._rate_from, 1e-9)
        self._rate_taken, self._rate_from = self.taken, now
        return count / seconds

    @property
    def lost(self) -> int:
        """Return how many transitions were not learned from, for whatever reason."""
        counts = dict(self.joiner.counts)
        return self.overrun + self.dropped + sum(counts.get(name, 0) for name in LOSSES)

    def figures(self) -> dict[str, float]:
        """Return its figures, for the diagnostics."""
        return {
            'waiting': len(self._waiting), 'image_bytes': self.joiner.held_bytes,
            'transitions_overrun': self.overrun, **{
                f'transitions_{name}': count for name, count in dict(self.joiner.counts).items()
                if count}}
