# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""CarRacing as a `Simulator`: commands in, frames and what the physics knows out."""
from __future__ import annotations

from collections.abc import Mapping

from carracing_sim_node.controls import Controls, controls
from carracing_sim_node.environment import CarRacingEnvironment
from carracing_sim_node.info_fields import CONSTANTS
from carracing_sim_node.settings import CarRacingSettings
from carracing_sim_node.simulation import Simulation
from msgs_bridge.simulator import FRAME_SECONDS, Outcome, Simulator
from msgs_bridge.twists import Command

RELEASED = Controls(0.0, 0.0, 0.0)


class CarRacing(Simulator):
    """CarRacing-v3, equal to gymnasium's to the byte and several times faster."""

    Settings = CarRacingSettings
    frame_seconds = FRAME_SECONDS
    deterministic = True
    draws_on_request = True

    def __init__(self, settings: CarRacingSettings) -> None:
        """
        Make the environment.

        Raises:
            RendererUnavailableError: the renderer `fast` is asked for and cannot run.
        """
        self.env = CarRacingEnvironment(
            zoom=settings.zoom, early_end_frames=settings.early_end_frames,
            early_end_lap=settings.early_end_lap, domain_randomize=settings.domain_randomize,
            max_episode_steps=settings.max_episode_frames, renderer=settings.renderer)
        self.constants = {name: float(getattr(settings, name)) for name in CONSTANTS}
        self.description = f'CarRacing-v3, {self.env.renderer_name} renderer'

    @property
    def world(self) -> Simulation:
        """Return gymnasium's CarRacing object (car, track, tiles), for those who look inside."""
        return self.env.simulation

    def reset(self, seed: int | None) -> Outcome:
        """Begin an episode on the track of a seed, or on the next one of the stream."""
        pixels, _ = self.env.reset(seed=seed)
        return Outcome(pixels, info=self._info(False, RELEASED))

    def advance(self, command: Command, frames: int = 1, *, draw: bool = True) -> Outcome:
        """Hold a command for up to some frames of 1/50 s."""
        pressed = controls(command)
        pixels, reward, terminated, truncated, passed = self.env.advance(
            pressed, frames, draw=draw)
        return Outcome(
            pixels, reward, terminated, truncated, self._info(terminated, pressed), passed)

    def skip(self, episodes: int, seed: int | None) -> None:
        """Go past some tracks, without cars or drawing."""
        self.env.skip_episodes(episodes, seed=seed)

    def close(self) -> None:
        """Let go of the environment."""
        self.env.close()

    def _info(self, terminated: bool, pressed: Controls) -> Mapping[str, float]:
        """Return the values of `info_fields.STEP_INFO`."""
        known = self.env.facts()
        return {
            'lap_finished': known.lap_finished,
            'left_field': terminated and not known.lap_finished,
            'ended_early': known.ended_early,
            'came_round': known.came_round,
            'tiles_visited': known.tiles_visited,
            'tiles_total': known.tiles_total,
            'tiles_missed': known.tiles_missed,
            'lap_position': known.lap_position,
            'wheels_off_road': known.wheels_off_road,
            'speed': known.speed,
            'standing_still': known.standing_still,
            'steer': pressed.steer,
            'gas': pressed.gas,
            'brake': pressed.brake,
        }
