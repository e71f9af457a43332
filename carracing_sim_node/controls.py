# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Commands <-> the controls of CarRacing, the one place that knows its signs.

CarRacing's positive steer is to the right; one signed number of a command carries gas and brake.
"""
from __future__ import annotations

from typing import NamedTuple

from msgs_bridge.twists import Command


class Controls(NamedTuple):
    """One action of CarRacing: steer in [-1, 1] (right > 0), gas and brake in [0, 1]."""

    steer: float
    gas: float
    brake: float


def controls(command: Command) -> Controls:
    """Return the controls of a command within [-1, 1]; gas and brake are never both on."""
    linear, angular = command
    # the sums and maxima give 0.0 for -0.0, which the physics and bags would tell apart
    return Controls(-angular + 0.0, max(linear, 0.0), max(-linear, 0.0))


def command_of(steer: float, gas: float, brake: float) -> Command:
    """Return the command that means some controls, of which gas or brake is 0."""
    return Command(gas - brake, -steer + 0.0)
