# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulator owes to the node, the validator and the evaluation that drive it."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np

from msgs_bridge.twists import Command

# seconds of one frame of CarRacing, which is meant where nothing else is said
FRAME_SECONDS = 0.02


class Outcome(NamedTuple):
    """
    What came of a reset or of a command.

    Attributes:
        pixels: uint8 (H, W, 3) rgb, of one size for the whole run, an array of its own.
        reward: since the outcome before, the environment's own; 0 after a reset.
        terminated: whether the rules ended the episode: nothing comes after.
        truncated: whether the episode was cut off: more would have come.
        info: further values by name, finite; the names stay the same for the whole run.
        frames: simulated frames that passed; 0 after a reset.
    """

    pixels: np.ndarray
    reward: float = 0.0
    terminated: bool = False
    truncated: bool = False
    info: Mapping[str, float] = MappingProxyType({})
    frames: int = 0


@dataclasses.dataclass(frozen=True)
class NoSettings:
    """The settings of a simulator that has none."""


class Simulator(Protocol):
    """
    A world that is driven by commands and seen in pixels.

    Inherit from this class: then what is given below need not be written. What a simulator raises
    on purpose is a `BridgeError`, best a `SimulatorError`; it ends the node with one line. It is
    made, driven and closed in one thread, to which OpenGL is bound.

    Attributes:
        Settings: settings class (`msgs_bridge.settings`), of which the constructor takes an
            instance; the settings become parameters of the node. A setting of the node's own,
            such as `action_repeat`, that is declared again gets another default here.
        frame_seconds: simulated seconds of one frame.
        constants: values by name that stay as they are for a run (variants, settings); they
            travel once, with `episode`. What bears the name of a setting is its value.
        seeded: whether `reset` obeys seeds; if not, it is never given any.
        deterministic: whether the same seed and commands give the same outcomes to the last bit,
            so that `carracing bag verify` can drive a bag again.
        draws_on_request: whether `advance` takes `draw`; with False it may return None in place
            of pixels and save the time.
        description: a few words for the log, such as the renderer in use.
    """

    Settings: type = NoSettings
    frame_seconds: float
    constants: Mapping[str, float] = MappingProxyType({})
    seeded: bool = True
    deterministic: bool = False
    draws_on_request: bool = False
    description: str = ''

    def reset(self, seed: int | None) -> Outcome:
        """Begin an episode; None goes on with the stream of the seed before."""
        ...

    def advance(self, command: Command, frames: int = 1) -> Outcome:
        """
        Hold a command for some simulated frames, fewer if the episode ends; draw the last.

        Args:
            command: within [-1, 1].
            frames: at least 1.
        """
        ...

    def skip(self, episodes: int, seed: int | None) -> None:
        """Go past some resets, the first of them with a seed if one is given."""
        for number in range(episodes):
            self.reset(None if number else seed)

    def close(self) -> None:
        """Let go of what it holds."""
