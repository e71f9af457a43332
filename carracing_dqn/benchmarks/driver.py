# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Scripted drivers that know the true track, for benchmarks and tests."""

from math import atan2
from math import cos
from math import pi
from math import sin

import numpy as np

from carracing_sim_node import CarRacingEnvironment

STYLES = ('lap', 'fast', 'random', 'spin', 'away', 'still')
"""Kinds of driving, see `Driver`."""

_AHEAD = 5
_BENDS_AHEAD = (6, 12, 18)


class Driver:
    """
    Drives one episode.

    Styles: `lap` follows the middle of the road and finishes most laps; `fast` does so too
    fast and leaves the road in bends; `random` holds random actions for random times; `spin`
    turns on the spot under full gas; `away` drives straight on until it leaves the playfield;
    `still` does next to nothing.
    """

    def __init__(self, env: CarRacingEnvironment, style: str, seed: int = 0) -> None:
        """Drive in `env`, whose `reset` has been called."""
        self._sim = env.simulation
        self._style = style
        self._rng = np.random.default_rng(seed)
        self._held = np.zeros(3, np.float32)
        self._hold_for = 0
        self._nearest = 0
        self._path = np.array([point[2:4] for point in self._sim.track])

    def act(self) -> np.ndarray:
        """Return the next action, float32 (3,)."""
        if self._style in ('lap', 'fast'):
            return self._follow(120.0, 0.8) if self._style == 'lap' else self._follow(160.0, 1.0)
        if self._style == 'spin':
            return np.array([1.0, 1.0, 0.0], np.float32)
        if self._style == 'away':
            return np.array([0.0, 0.8, 0.0], np.float32)
        if self._style == 'still':
            return np.array([0.0, 0.0, 0.5], np.float32)
        return self._hold()

    def _hold(self) -> np.ndarray:
        """Return a random action that is held for 1 to 40 frames."""
        if not self._hold_for:
            self._hold_for = int(self._rng.integers(1, 40))
            steer = self._rng.choice([-1.0, -0.6, 0.0, 0.6, 1.0, self._rng.uniform(-1, 1)])
            gas = self._rng.choice([0.0, 1.0, self._rng.uniform()], p=[0.3, 0.4, 0.3])
            brake = self._rng.choice([0.0, 0.2, 0.8, 1.0], p=[0.7, 0.1, 0.1, 0.1])
            self._held = np.array([steer, gas, brake], np.float32)
        self._hold_for -= 1
        return self._held

    def _follow(self, top_speed: float, pedal: float) -> np.ndarray:
        """Return the action that steers for a point ahead on the middle of the road."""
        sim = self._sim
        hull = sim.car.hull
        position = np.array([hull.position.x, hull.position.y])
        count = len(self._path)
        window = (self._nearest + np.arange(-10, 30)) % count
        distances = ((self._path[window] - position) ** 2).sum(axis=1)
        self._nearest = int(window[distances.argmin()])
        target = self._path[(self._nearest + _AHEAD) % count] - position
        # The car's nose points along its y axis.
        error = _wrap(atan2(target[1], target[0]) - (hull.angle + pi / 2))
        heading = sim.track[self._nearest][1]
        bend = max(
            abs(_wrap(sim.track[(self._nearest + ahead) % count][1] - heading))
            for ahead in _BENDS_AHEAD
        )
        wanted = top_speed / (1.0 + bend)
        # The turning that is under way counts against the steering, which would swing otherwise
        # when an action is held for several frames.
        steer = float(np.clip(-error + 0.2 * hull.angularVelocity, -1.0, 1.0))
        # Gas while steering spins this car.
        gas = pedal * (1.0 - abs(steer)) if sim.speed < wanted else 0.0
        brake = 0.2 if sim.speed > wanted + 8.0 else 0.0
        return np.array([steer, gas, brake], np.float32)


def _wrap(angle: float) -> float:
    """Return `angle` between -pi and pi."""
    return atan2(sin(angle), cos(angle))
