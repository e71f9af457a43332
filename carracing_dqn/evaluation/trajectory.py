# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where the car was, frame by frame, and what the track looked like."""
from __future__ import annotations

from collections.abc import Iterable
import dataclasses
from typing import Any

from carracing_dqn.evaluation.laps import drive_lap, Lap, Policy
from gymnasium.envs.box2d.car_racing import FPS, TRACK_WIDTH
from msgs_bridge.simulator import Simulator
from msgs_bridge.twists import Command, STOP
import numpy as np


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """
    One lap seen from above. Lengths are in metres (units of the physics).

    Attributes:
        lap: what it came to.
        position: float (frames, 2).
        speed: float (frames,), m/s.
        reward: float (frames,), the environment's own.
        wheels_off: int (frames,), wheels that touch no road tile, 0 to 4.
        left_edge, right_edge: float (tiles, 2), edges of the road in driving direction.
        visited: bool (tiles,).
    """

    lap: Lap
    position: np.ndarray
    speed: np.ndarray
    reward: np.ndarray
    wheels_off: np.ndarray
    left_edge: np.ndarray
    right_edge: np.ndarray
    visited: np.ndarray

    @property
    def off_road(self) -> list[tuple[int, int]]:
        """Return first and last frame of every stretch with all four wheels off the road."""
        off = np.concatenate(([False], self.wheels_off == 4, [False])).astype(int)
        starts = np.flatnonzero(np.diff(off) == 1)
        ends = np.flatnonzero(np.diff(off) == -1) - 1
        return list(zip(starts.tolist(), ends.tolist()))

    @property
    def reward_rate(self) -> np.ndarray:
        """Return the reward of the half second around each frame, in points a second."""
        half = FPS // 4
        sums = np.concatenate(([0.0], np.cumsum(self.reward)))
        frames = np.arange(len(self.reward))
        first = np.maximum(frames - half, 0)
        last = np.minimum(frames + half + 1, len(self.reward))
        return (sums[last] - sums[first]) * FPS / (last - first)


class _Recorder:
    """Collects one row a frame."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, float, float, int]] = []

    def __call__(self, world: Any, reward: float) -> None:
        hull = world.car.hull
        velocity = hull.linearVelocity
        self.rows.append((
            hull.position.x, hull.position.y, velocity.length, reward,
            sum(not wheel.tiles for wheel in world.car.wheels)))


def drive_trajectory(simulator: Simulator, policy: Policy, seed: int) -> Trajectory:
    """
    Drive a lap of CarRacing as `laps.drive_lap` does and keep where the car was.

    Raises:
        PolicyError: an answer that is no command.
        EvaluationError: a simulator that is not CarRacing.
    """
    recorder = _Recorder()
    lap = drive_lap(simulator, policy, seed, watch=recorder)
    world = simulator.world
    track = np.array([(beta, x, y) for _, beta, x, y in world.track])
    across = TRACK_WIDTH * np.stack((np.cos(track[:, 0]), np.sin(track[:, 0])), axis=1)
    # the polygon of tile i reaches from point i to the one before, as gymnasium lays it
    visited = np.zeros(len(track), bool)
    for tile in world.road:
        visited[tile.idx] = tile.road_visited
    rows = np.array(recorder.rows, dtype=float)
    return Trajectory(
        lap=lap, position=rows[:, :2], speed=rows[:, 2], reward=rows[:, 3],
        wheels_off=rows[:, 4].astype(int), left_edge=track[:, 1:] - across,
        right_edge=track[:, 1:] + across, visited=visited)


class RecordedActions:
    """A policy that repeats commands, one a frame; coasts when there are no more."""

    looks_at_frames = False

    def __init__(self, actions: Iterable[Command]) -> None:
        """Keep the command of every simulated frame."""
        self._actions = list(actions)
        self._next = 0

    def reset(self, seed: int | None = None) -> None:
        """Start from the first action again."""
        self._next = 0

    def act(self, frame: np.ndarray) -> Command:
        """Return the next command, whatever the frame shows."""
        self._next += 1
        if self._next > len(self._actions):
            return STOP
        return self._actions[self._next - 1]
