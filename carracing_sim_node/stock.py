# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Gymnasium's own CarRacing as a `Simulator`, for those who want to see it from the source."""
from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from carracing_sim_node.controls import controls
from carracing_sim_node.settings import GymnasiumSettings
from carracing_sim_node.simulation import STANDING_SPEED
import gymnasium
from msgs_bridge.simulator import FRAME_SECONDS, Outcome, Simulator
from msgs_bridge.twists import Command
import numpy as np

GYMNASIUM_ID = 'CarRacing-v3'


class GymnasiumCarRacing(Simulator):
    """The unmodified `gymnasium.make('CarRacing-v3')`; the info is read from its physics."""

    Settings = GymnasiumSettings
    frame_seconds = FRAME_SECONDS
    deterministic = True
    description = f'gymnasium.make({GYMNASIUM_ID!r})'

    def __init__(self, settings: GymnasiumSettings) -> None:
        """Make the environment."""
        self.env = gymnasium.make(GYMNASIUM_ID, max_episode_steps=settings.max_episode_frames)
        self.constants = {'max_episode_frames': float(settings.max_episode_frames)}
        self._standing_still = 0

    @property
    def world(self) -> Any:
        """Return gymnasium's CarRacing object (car, track, tiles), for those who look inside."""
        return self.env.unwrapped

    def reset(self, seed: int | None) -> Outcome:
        """Begin an episode on the track of a seed, or on the next one of the stream."""
        self._standing_still = 0
        pixels, _ = self.env.reset(seed=seed)
        return Outcome(pixels, info=self._info(False, {}))

    def advance(self, command: Command, frames: int = 1) -> Outcome:
        """Hold a command for up to some frames of 1/50 s."""
        # as float64, which is how the physics computes with it
        action = np.array(controls(command))
        reward, passed = 0.0, 0
        terminated = truncated = False
        while passed < frames and not (terminated or truncated):
            pixels, earned, terminated, truncated, info = self.env.step(action)
            reward = reward + earned if passed else earned
            passed += 1
            self._standing_still = (
                self._standing_still + 1 if self._speed() < STANDING_SPEED else 0)
        return Outcome(
            pixels, float(reward), terminated, truncated, self._info(terminated, info), passed)

    def close(self) -> None:
        """Let go of the environment."""
        self.env.close()

    def _speed(self) -> float:
        velocity = self.world.car.hull.linearVelocity
        return math.sqrt(velocity.x * velocity.x + velocity.y * velocity.y)

    def _info(self, terminated: bool, info: Mapping[str, Any]) -> Mapping[str, float]:
        """Return those values of `info_fields.STEP_INFO` that gymnasium's code knows of."""
        world = self.world
        lap_finished = bool(info.get('lap_finished', False))
        return {
            'lap_finished': lap_finished,
            'left_field': terminated and not lap_finished,
            'tiles_visited': world.tile_visited_count,
            'tiles_total': len(world.track),
            'wheels_off_road': 0.25 * sum(not wheel.tiles for wheel in world.car.wheels),
            'speed': self._speed(),
            'standing_still': self._standing_still,
        }
