# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulator says of a training in it: its frames, and the hyperparameters it asks for."""
from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from carracing_dqn.simulation import make_simulator
from carracing_dqn.simulation.checks import Checks
from carracing_dqn.simulation.profiles import profile_of, seen_from

PRESET = 'racing'
"""Preset of a run that names neither one nor a simulator."""
SIMULATOR_PRESET = 'pixels'
"""Preset for a simulator whose profile names none."""
OBSERVATION_SIDE = 42
"""Least rows and columns of what the network of that preset sees, of larger frames."""
MAX_SHRINK = 8


def choose_preset(preset: str | None, simulator: str | None) -> str:
    """Return the preset that was named, or that of a simulator's profile, or the default."""
    if preset is None and simulator is not None:
        return str(profile_of(simulator).training.get('preset', SIMULATOR_PRESET))
    return preset or PRESET


def settings_from(name: str, preset: str, folder: Path) -> dict[str, Any]:
    """
    Return hyperparameters by name: how a simulator looks, and what its profile says.

    Args:
        name: of the simulator, as it is said here.
        preset: of the run; `pixels` shrinks frames of any size to about the same.
        folder: of the run, where its processes are.

    Raises:
        SimulatorError, SettingsError: there is no such simulator, or it cannot run here.
    """
    looks = _looks(name)
    shrink = {'shrink': _shrink(looks['frame_height'], looks['frame_width'])}
    values = {'simulator': seen_from(name, folder), **looks,
              **(shrink if preset == SIMULATOR_PRESET else {}), **profile_of(name).training}
    values.pop('preset', None)
    return values


@functools.cache
def _looks(name: str) -> dict[str, Any]:
    """Return size and duration of the frames of a simulator; some take seconds to be made."""
    simulator, checks = make_simulator(name), Checks(name)
    try:
        first = checks.reset(simulator, 0 if simulator.seeded else None)
        height, width, _ = first.pixels.shape
        return {'frame_height': height, 'frame_width': width,
                'frame_seconds': checks.frame_seconds(simulator)}
    finally:
        checks.close(simulator)


def _shrink(height: int, width: int) -> int:
    """Return by how much frames are shrunk, so that little more than is needed is left."""
    return max(by for by in range(1, MAX_SHRINK + 1) if height % by == width % by == 0 and (
        by == 1 or min(height, width) / by >= OBSERVATION_SIDE))
