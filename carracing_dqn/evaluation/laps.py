# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Greedy laps: one seeded episode each, the whole reward, nothing cut short."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import time
from typing import Any, Protocol

from carracing_dqn.evaluation.errors import EvaluationError, PolicyError
from carracing_dqn.simulation.checks import Checks
from carracing_sim_node.controls import command_of
from msgs_bridge.simulator import Simulator
from msgs_bridge.step import MAX_WHOLE
from msgs_bridge.twists import Command
import numpy as np

MAX_FRAMES = 200_000
"""Of an episode: CarRacing's, 1000 frames, has ended long before."""

RETURN_DIGITS = 6
"""Returns are rounded to this, so that they do not show in which order rewards were added."""


class Policy(Protocol):
    """What can be evaluated: frames in, commands out."""

    def reset(self, seed: int | None = None) -> None:
        """Forget the episode before; `seed` is for policies that draw at random."""

    def act(self, frame: np.ndarray) -> Command:
        """Return the command for a frame, uint8 (H, W, 3) rgb, of every simulated one."""


Watch = Callable[[Any, float], None]
"""Called after every frame with gymnasium's CarRacing object and the reward of the frame."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """
    One episode and how it went; what the simulator does not say is None.

    Attributes:
        seed: seed of the episode (and of a policy that draws at random).
        episode_return: sum of the environment's own rewards.
        frames: simulated frames, in CarRacing of 1/50 s.
        tiles_visited, tiles_total: tiles of the track.
        lap_finished: all tiles were visited.
        left_field: the car left the playfield.
        standing_still: frames in a row the car had stood still when the episode ended.
        seconds: wall time; not compared, because nothing else depends on the machine.
    """

    seed: int
    episode_return: float
    frames: int
    tiles_visited: int | None = None
    tiles_total: int | None = None
    lap_finished: bool | None = None
    left_field: bool | None = None
    standing_still: int | None = None
    seconds: float = dataclasses.field(default=0.0, compare=False)


def picture_name(seed: int) -> str:
    """Return how the file of the picture of a lap is called."""
    return f'lap_{seed}.png'


def lap_of(
    seed: int, episode_return: float, frames: int, info: Mapping[str, float], seconds: float,
) -> Lap:
    """Return a lap with what the info of its last frame says, as far as that can be."""
    kinds = {'tiles_visited': int, 'tiles_total': int, 'lap_finished': bool, 'left_field': bool,
             'standing_still': int}
    # a file of laps holds no larger whole number; written so that NaN fails
    values = {name: kind(info[name]) for name, kind in kinds.items()
              if name in info and abs(info[name]) <= MAX_WHOLE}
    # a simulator that says nonsense of its tiles says nothing of them
    if not 0 <= values.get('tiles_visited', -1) <= values.get('tiles_total', 0) != 0:
        values = {name: value for name, value in values.items() if 'tiles' not in name}
    return Lap(seed, round(episode_return, RETURN_DIGITS), frames, seconds=seconds, **values)


def drive_lap(
    simulator: Simulator, policy: Policy, seed: int, *, watch: Watch | None = None,
) -> Lap:
    """
    Drive one episode of a seed.

    With a simulator that can leave frames undrawn, only the frames a policy with `action_repeat`
    looks at are drawn; in between it gets the last drawn frame again.

    Args:
        simulator: any; its first frame is that of a reset.
        policy: see `Policy`; without `action_repeat` it looks at every frame.
        seed: of the episode, for a simulator that obeys seeds.
        watch: called after every frame; for the simulators of CarRacing.

    Raises:
        PolicyError: an answer that is no command, or that CarRacing cannot obey.
        SimulatorError: what the simulator gives is none of what it owes.
        EvaluationError: somebody wants to watch a simulator that is not CarRacing, or the episode
            has no end.
    """
    started = time.perf_counter()
    world = getattr(simulator, 'world', None)
    # somebody's simulator may have a world of its own
    if watch is not None and not (hasattr(world, 'car') and hasattr(world, 'road')):
        raise EvaluationError(
            f'a {type(simulator).__name__} has no track to look at; CarRacing has')
    look_every = looks_every(policy) if simulator.draws_on_request else 1
    checks = Checks(type(simulator).__name__)
    outcome = checks.reset(simulator, seed if simulator.seeded else None)
    policy.reset(seed)
    frame = outcome.pixels
    total, frames = 0.0, 0
    while not (outcome.terminated or outcome.truncated):
        command = checked_command(policy.act(frame))
        frames += 1
        if frames > MAX_FRAMES:
            raise EvaluationError(f'seed {seed}: no end after {MAX_FRAMES} frames; a limit such '
                                  'as max_episode_frames in a profile would give it one')
        outcome = checks.advance(
            simulator, command, draw=look_every > 0 and frames % look_every == 0)
        frame = frame if outcome.pixels is None else outcome.pixels
        total += float(outcome.reward)
        if watch is not None:
            watch(world, float(outcome.reward))
    checks.episode_return(total)
    return lap_of(seed, total, frames, outcome.info, time.perf_counter() - started)


def looks_every(policy: Policy) -> int:
    """Return every how many frames a policy looks at one; 1 when it does not say, 0 for never."""
    if not getattr(policy, 'looks_at_frames', True):
        return 0
    return max(1, int(getattr(policy, 'action_repeat', 1)))


def checked_command(answer: Any) -> Command:
    """
    Return the command that a policy has answered: (linear, angular), or (steer, gas, brake).

    Raises:
        PolicyError: neither, not finite, out of range, or gas and brake at once.
    """
    try:
        values = tuple(map(float, answer))
    except (TypeError, ValueError, OverflowError):
        values = ()
    # written so that NaN fails: every comparison with it is False
    if len(values) == 2 and all(-1.0 <= value <= 1.0 for value in values):
        return Command(*values)
    if len(values) == 3 and _pedals(*values):
        return command_of(*values)
    raise PolicyError(
        f'the policy answered {_shown(answer)}; expected two numbers in [-1, 1], linear and '
        "angular, or CarRacing's steer in [-1, 1], gas and brake in [0, 1], one of them 0")


def _pedals(steer: float, gas: float, brake: float) -> bool:
    """Return whether one signed number can carry gas and brake, and all are in range."""
    return (-1.0 <= steer <= 1.0 and 0.0 <= gas <= 1.0 and 0.0 <= brake <= 1.0
            and min(gas, brake) == 0.0)


def _shown(answer: Any) -> str:
    if isinstance(answer, Sequence) and not isinstance(answer, (str, bytes)):
        answer = tuple(answer[:4])
    return repr(answer)[:100]
