# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulator owes to the node, the validator and the evaluation that drive it."""
from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from msgs_bridge.twists import Command


class Outcome(NamedTuple):
    """
    What came of a reset or of a command.

    Attributes:
        pixels: uint8 (H, W, 3) rgb, of one size for the whole run.
        reward: since the outcome before, the environment's own; 0 after a reset.
        terminated: whether the rules ended the episode: nothing comes after.
        truncated: whether the episode was cut off: more would have come.
        info: further values by name, finite; the names stay the same for the whole run.
        frames: simulated frames that passed; 0 after a reset.
    """

    pixels: np.ndarray
    reward: float
    terminated: bool
    truncated: bool
    info: Mapping[str, float]
    frames: int


class Simulator(Protocol):
    """
    A world that is driven by commands and seen in pixels.

    A class of this kind has a settings class (`msgs_bridge.settings`) as its attribute
    `Settings`, of which its constructor takes an instance; the settings become parameters of the
    node. What it raises on purpose is a `BridgeError`.

    Attributes:
        frame_seconds: simulated seconds of one frame.
        constants: values by name that stay as they are for a run (variants, settings); they
            travel once, with `episode`.
    """

    frame_seconds: float
    constants: Mapping[str, float]

    def reset(self, seed: int | None) -> Outcome:
        """Begin an episode; None goes on with the stream of the seed before."""

    def advance(self, command: Command, frames: int) -> Outcome:
        """
        Hold a command for some simulated frames, fewer if the episode ends; draw the last.

        Args:
            command: within [-1, 1].
            frames: at least 1.
        """

    def close(self) -> None:
        """Let go of what it holds."""
