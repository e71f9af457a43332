# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Answers images by their stamps, whatever their rate: new decision, held action or resent frame.

The policy needs no word from the simulator on where an episode begins; `image_time` has the rule.
"""
from __future__ import annotations

from dqn_policy_node.action_hold import ActionHold
from dqn_policy_node.image_time import ImageTime, Place
from dqn_policy_node.policy import Answer, Policy, RandomPolicy
from msgs_bridge.stamps import NANOSECONDS
import numpy as np


class Pilot:
    """
    Drives one policy by stamped images.

    Attributes:
        policy: what decides.
        sequences: how many there were; each begins with an empty stack of frames.
        elapsed: ns from the image before to the newest, 0 if that is none that follows it.
    """

    def __init__(
        self, policy: Policy | RandomPolicy, sequence_gap: int = NANOSECONDS // 2,
    ) -> None:
        """Start without an image; a gap of `sequence_gap` ns begins a new sequence."""
        self.policy = policy
        self.sequences = 0
        self.elapsed = 0
        self._time = ImageTime(sequence_gap)
        self._hold = ActionHold()
        self._frame: np.ndarray | None = None
        self._now = self._decided = 0
        self._answer: Answer | None = None

    def answer(self, stamp: int, frame: np.ndarray, arrived: int) -> Answer:
        """
        Return the answer to an image.

        Args:
            stamp: of the image, ns.
            frame: uint8 (frame_height, frame_width, 3) rgb, not changed afterwards.
            arrived: when it came by a clock that never goes back, ns.

        Raises:
            BridgeError: the frame is not of the size the model takes.
        """
        place, self.elapsed = self._time.place(
            stamp, arrived, lambda: np.array_equal(frame, self._frame))
        if place in (Place.AGAIN, Place.LATE) and self._answer is not None:
            return self._answer if place is Place.AGAIN else self._answer.held()
        self._frame = frame
        self._now += self.elapsed
        if place is not Place.NEXT or self._answer is None:
            self.sequences += 1
            self.policy.reset()
            self._hold.reset()
            self._answer, self._decided = None, self._now
        if self._hold.is_due(self._now, round(self.policy.action_seconds * NANOSECONDS)):
            self._answer = self.policy.decide(frame, self._now - self._decided)
            self._decided = self._now
        else:
            self._answer = self._answer.held()
        return self._answer
