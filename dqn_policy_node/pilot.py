# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Answers images by their stamps, whatever their rate: new decision, held action or resent frame.

The policy needs no word from the simulator on where an episode begins: a gap in the stamps is a
new scene, in any simulator.
"""
from __future__ import annotations

import dataclasses

from dqn_policy_node.policy import Decision, Policy
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.twists import Command
import numpy as np

FRAME_NANOSECONDS = NANOSECONDS // 50
# a camera's stamps may jitter by this much before a decision slips by one frame
JITTER_NANOSECONDS = FRAME_NANOSECONDS // 2


@dataclasses.dataclass(frozen=True)
class Answer:
    """The command for one image, and the decision if this image led to a new one."""

    command: Command
    decision: Decision | None


class Pilot:
    """Drives one policy by stamped images."""

    def __init__(self, policy: Policy, scene_gap: int = NANOSECONDS // 2) -> None:
        """Start without a scene; `scene_gap` in ns is the gap that makes a new one."""
        self.policy = policy
        self.scene_gap = scene_gap
        self.scenes = 0
        self._stamp: int | None = None
        self._due = 0
        self._decided = 0
        self._answer: Answer | None = None

    def answer(self, stamp: int, frame: np.ndarray) -> Answer:
        """
        Return the action for an image.

        Args:
            stamp: of the image, ns; one that was answered before gets the same answer.
            frame: uint8 (H, W, 3) rgb.

        Raises:
            BridgeError: the frame is not of the size the model takes.
        """
        if stamp == self._stamp and self._answer is not None:
            return self._answer
        if self._stamp is None or not 0 < stamp - self._stamp <= self.scene_gap:
            self.policy.reset()
            self.scenes += 1
            self._due = self._decided = stamp
        if stamp >= self._due - JITTER_NANOSECONDS:
            elapsed = round((stamp - self._decided) / FRAME_NANOSECONDS)
            decision = self.policy.decide(frame, elapsed)
            self._decided = stamp
            self._due = stamp + self.policy.action_repeat * FRAME_NANOSECONDS
            self._answer = Answer(decision.command, decision)
        else:
            self._answer = Answer(self._answer.command, None)
        self._stamp = stamp
        return self._answer
