# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Greedy laps: one seeded track an episode, the whole reward, nothing cut short."""
from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
import time
from typing import Any, Protocol

from carracing_sim_node.controls import controls
from carracing_sim_node.simulation import STANDING_SPEED
from carracing_dqn.evaluation.errors import PolicyError
from carracing_dqn.evaluation.simulators import draws_on_request, world_of
import gymnasium
from msgs_bridge.twists import Command
import numpy as np

RETURN_DIGITS = 6
"""Returns are rounded to this, so that they do not show in which order rewards were added."""


class Policy(Protocol):
    """What can be evaluated: frames in, actions out."""

    def reset(self, seed: int | None = None) -> None:
        """Forget the episode before; `seed` is for policies that draw at random."""

    def act(self, frame: np.ndarray) -> tuple[float, float, float]:
        """Return (steer, gas, brake) for a frame, uint8 (96, 96, 3) rgb, of every 1/50 s."""


Watch = Callable[[Any, float], None]
"""Called after every frame with gymnasium's CarRacing object and the reward of the frame."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """
    One episode and how it went; names as in `episode` message.

    Attributes:
        seed: seed of the track (and of a policy that draws at random).
        episode_return: sum of the environment's own rewards.
        frames: simulator frames of 1/50 s.
        tiles_visited, tiles_total: tiles of the track.
        lap_finished: all tiles were visited.
        left_field: the car left the playfield.
        standing_still: frames in a row the car had stood still when the episode ended.
        seconds: wall time; not compared, because nothing else depends on the machine.
    """

    seed: int
    episode_return: float
    frames: int
    tiles_visited: int
    tiles_total: int
    lap_finished: bool
    left_field: bool
    standing_still: int
    seconds: float = dataclasses.field(default=0.0, compare=False)


def drive_lap(
    env: gymnasium.Env, policy: Policy, seed: int, *, watch: Watch | None = None,
) -> Lap:
    """
    Drive one episode on the track of a seed.

    With an environment that can leave frames undrawn, only the frames a policy with
    `action_repeat` looks at are drawn; in between it gets the last drawn frame again.

    Args:
        env: a CarRacing-v3, gymnasium's or ours.
        policy: see `Policy`; without `action_repeat` it looks at every frame.
        seed: seed of the track.
        watch: called after every frame.

    Raises:
        PolicyError: an action that is not three finite numbers in range.
    """
    started = time.perf_counter()
    world = world_of(env)
    look_every = looks_every(policy) if draws_on_request(env) else 1
    frame, _ = env.reset(seed=seed)
    policy.reset(seed)
    total, frames, standing_still = 0.0, 0, 0
    terminated = truncated = False
    info: dict[str, Any] = {}
    while not (terminated or truncated):
        action = checked_action(policy.act(frame))
        frames += 1
        if look_every == 1:
            frame, reward, terminated, truncated, info = env.step(action)
        else:
            drawn, reward, terminated, truncated, info = env.step(
                action, draw=look_every > 0 and frames % look_every == 0)
            frame = frame if drawn is None else drawn
        total += float(reward)
        velocity = world.car.hull.linearVelocity
        speed = math.sqrt(velocity.x * velocity.x + velocity.y * velocity.y)
        standing_still = standing_still + 1 if speed < STANDING_SPEED else 0
        if watch is not None:
            watch(world, float(reward))
    lap_finished = bool(info.get('lap_finished', False))
    return Lap(
        seed=seed, episode_return=round(total, RETURN_DIGITS), frames=frames,
        tiles_visited=world.tile_visited_count, tiles_total=len(world.track),
        lap_finished=lap_finished, left_field=bool(terminated) and not lap_finished,
        standing_still=standing_still, seconds=time.perf_counter() - started)


def looks_every(policy: Policy) -> int:
    """Return every how many frames a policy looks at one; 1 when it does not say, 0 for never."""
    if not getattr(policy, 'looks_at_frames', True):
        return 0
    return max(1, int(getattr(policy, 'action_repeat', 1)))


def checked_action(action: Any) -> np.ndarray:
    """
    Return an action as float64 (3,), which is how the physics computes with it.

    Raises:
        PolicyError: not three numbers, not finite, or out of range.
    """
    try:
        if isinstance(action, Command):
            action = controls(action)
        steer, gas, brake = (float(value) for value in action)
    except (TypeError, ValueError):
        raise PolicyError(
            f'the policy answered {action!r}; expected (steer, gas, brake)') from None
    # written so that NaN fails: every comparison with it is False
    if -1.0 <= steer <= 1.0 and 0.0 <= gas <= 1.0 and 0.0 <= brake <= 1.0:
        return np.array((steer, gas, brake))
    raise PolicyError(
        f'the policy answered steer {steer}, gas {gas}, brake {brake}; '
        'expected steer in [-1, 1], gas and brake in [0, 1]')
