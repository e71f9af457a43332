# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes one after the other on one clock: what the node publishes, without ROS."""
from __future__ import annotations

import dataclasses

import numpy as np

from carracing_sim_node.controls import controls
from carracing_sim_node.environment import make_env
from carracing_sim_node.settings import SimulatorSettings
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import CONTRACT_VERSION
from msgs_bridge.twists import Command, STOP

FRAME_NANOSECONDS = 20_000_000
# A gap that no frame rate of ours can make, so that a policy sees a new scene by the stamps alone.
RESET_NANOSECONDS = NANOSECONDS


@dataclasses.dataclass(frozen=True)
class Frame:
    """
    One published frame.

    Attributes:
        stamp: simulation time in ns.
        pixels: uint8 (96, 96, 3) rgb.
        facts: what goes out as `step`, by name.
        summary: what goes out as `episode` on the first and last frame of one, else None.
    """

    stamp: int
    pixels: np.ndarray
    facts: dict[str, float]
    summary: dict[str, float] | None

    @property
    def ended(self) -> bool:
        """Return whether the episode ends with this frame."""
        return bool(self.facts['terminated'] or self.facts['truncated'])


class Drive:
    """A series of episodes; `begin` starts the next one, `advance` drives one decision."""

    def __init__(self, settings: SimulatorSettings) -> None:
        """Make the environment; nothing is driven yet."""
        self.settings = settings
        self.env = make_env(
            action_repeat=settings.action_repeat, zoom=settings.zoom,
            early_end_frames=settings.early_end_frames,
            early_end_lap=settings.early_end_lap,
            domain_randomize=settings.domain_randomize,
            max_episode_steps=settings.max_episode_frames, renderer=settings.renderer)
        self.episode = settings.first_episode - 1
        self.stamp = 0
        self.decision = 0
        self.unanswered = 0
        self.episode_return = 0.0
        self._started = False

    @property
    def finished(self) -> bool:
        """Return whether all episodes asked for have been begun."""
        wanted = self.settings.episodes
        return wanted > 0 and self.episode + 1 >= self.settings.first_episode + wanted

    @property
    def seed(self) -> int:
        """Return the seed of the present track; -1 when it came from the stream."""
        if self.settings.seed_each_episode:
            return self.settings.seed + self.episode
        return self.settings.seed if self.episode == 0 else -1

    def begin(self) -> Frame:
        """Reset to the next track and return its first frame."""
        self.episode += 1
        settings = self.settings
        if settings.seed_each_episode:
            pixels, _ = self.env.reset(seed=self.seed)
        elif self._started:
            pixels, _ = self.env.reset()
        elif settings.first_episode:
            self.env.skip_episodes(settings.first_episode, seed=settings.seed)
            pixels, _ = self.env.reset()
        else:
            pixels, _ = self.env.reset(seed=settings.seed)
        self._started = True
        self.decision = 0
        self.unanswered = 0
        self.episode_return = 0.0
        self.stamp += RESET_NANOSECONDS
        facts = self._facts(0.0, False, False, False, STOP, None, 0)
        return Frame(self.stamp, pixels, facts, self._summary(facts))

    def advance(self, command: Command, applied_stamp: int | None) -> Frame:
        """
        Drive one decision and return the frame that follows.

        Args:
            command: what drives the car, within [-1, 1].
            applied_stamp: stamp in ns of the twist it came from; None when there was none.
        """
        before = self.env.facts().frames
        pixels, reward, terminated, truncated, info = self.env.step(controls(command))
        frames = self.env.facts().frames - before
        self.decision += 1
        self.unanswered += applied_stamp is None
        self.episode_return += reward
        self.stamp += frames * FRAME_NANOSECONDS
        left_field = terminated and not info.get('lap_finished', False)
        facts = self._facts(
            reward, terminated, truncated, left_field, command, applied_stamp, frames)
        summary = self._summary(facts) if terminated or truncated else None
        return Frame(self.stamp, pixels, facts, summary)

    def _facts(
        self, reward: float, terminated: bool, truncated: bool, left_field: bool,
        command: Command, applied_stamp: int | None, frames: int,
    ) -> dict[str, float]:
        known = self.env.facts()
        seconds, nanoseconds = (
            (-1, 0) if applied_stamp is None else divmod(applied_stamp, NANOSECONDS))
        return {
            'reward': reward,
            'terminated': terminated,
            'truncated': truncated,
            'lap_finished': known.lap_finished and not left_field,
            'left_field': left_field,
            'ended_early': known.ended_early,
            'came_round': known.came_round,
            'episode': self.episode,
            'seed': self.seed,
            'decision': self.decision,
            'step': known.frames,
            'episode_return': self.episode_return,
            'tiles_visited': known.tiles_visited,
            'tiles_total': known.tiles_total,
            'tiles_missed': known.tiles_missed,
            'lap_position': known.lap_position,
            'wheels_off_road': known.wheels_off_road,
            'speed': known.speed,
            'standing_still': known.standing_still,
            'linear': command.linear,
            'angular': command.angular,
            'applied_sec': seconds,
            'applied_nanosec': nanoseconds,
            'frames': frames,
        }

    def _summary(self, facts: dict[str, float]) -> dict[str, float]:
        shared = (
            'episode', 'seed', 'episode_return', 'lap_finished', 'left_field', 'ended_early',
            'terminated', 'truncated', 'tiles_visited', 'tiles_total', 'standing_still')
        return {
            **{name: facts[name] for name in shared},
            'frames': facts['step'], 'decisions': self.decision, 'unanswered': self.unanswered,
            'contract_version': CONTRACT_VERSION,
            'frame_seconds': FRAME_NANOSECONDS / NANOSECONDS,
            **{name: getattr(self.settings, name) for name in (
                'action_repeat', 'zoom', 'domain_randomize', 'early_end_frames',
                'early_end_lap')},
        }
