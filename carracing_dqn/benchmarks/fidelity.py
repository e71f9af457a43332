# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Drives gymnasium's CarRacing-v3 and ours alike and compares everything that they return."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field
from itertools import count
from typing import Any

import gymnasium
import numpy as np

from carracing_dqn.benchmarks.driver import STYLES
from carracing_dqn.benchmarks.driver import Driver
from carracing_sim_node import make_env

REPEATS = (1, 1, 4, 1, 2, 3, 8)
"""Action repeats, in turn; only the last frame of a group can be compared."""

_OFF_ROAD = 1.0
_FAR_OFF_ROAD_FRAMES = 50
_AT_SPEED = 60.0
_SPINNING = 4.0


@dataclass
class Fidelity:
    """What a comparison has found."""

    frames: int = 0
    """Frames compared byte for byte, those of `reset` included."""

    simulated: int = 0
    """Frames whose physics was compared by its reward, ends and info."""

    episodes: int = 0
    differences: int = 0
    first_difference: str = ''
    variety: Counter[str] = field(default_factory=Counter)
    """Compared frames of each kind, and how often each end of an episode was reached."""


def compare(
    frames: int,
    *,
    first_seed: int = 0,
    episode_frames: int = 1000,
    styles: tuple[str, ...] = STYLES,
    repeats: tuple[int, ...] = REPEATS,
    on_progress: Callable[[Fidelity], None] | None = None,
) -> Fidelity:
    """
    Compare episode after episode until at least `frames` frames are compared.

    Every episode has another seed, style of driving, action repeat and colouring. All seeds,
    actions and lengths follow from the arguments, so a difference can be driven again.

    Args:
        frames: Frames to compare.
        first_seed: Seed of the first track.
        episode_frames: Leave an episode after this many frames.
        styles: Styles of `Driver`, in turn.
        repeats: Action repeats, in turn.
        on_progress: Called with the findings so far after every episode.
    """
    found = Fidelity()
    stock = {
        randomize: gymnasium.make(
            'CarRacing-v3', domain_randomize=randomize, disable_env_checker=True
        )
        for randomize in (False, True)
    }
    ours = {
        (randomize, repeat): make_env(
            renderer='fast', domain_randomize=randomize, action_repeat=repeat
        )
        for randomize in (False, True)
        for repeat in set(repeats)
    }
    for episode in count():
        if found.frames >= frames:
            break
        style = styles[episode % len(styles)]
        repeat = repeats[episode // len(styles) % len(repeats)]
        randomize = episode % 5 == 4
        name = f'seed {first_seed + episode}, {style}, repeat {repeat}, randomize {randomize}'
        _compare_episode(
            stock[randomize],
            ours[randomize, repeat],
            style=style,
            seed=first_seed + episode,
            limit=min(episode_frames, frames - found.frames),
            name=name,
            found=found,
        )
        found.episodes += 1
        if on_progress is not None:
            on_progress(found)
    return found


def _compare_episode(
    stock: gymnasium.Env,
    ours: Any,
    *,
    style: str,
    seed: int,
    limit: int,
    name: str,
    found: Fidelity,
) -> None:
    """Compare the first `limit` simulated frames of one episode, counting into `found`."""
    core = stock.unwrapped
    drawing = type(core)._render.__get__(core)
    core._render = drawing
    expected = stock.reset(seed=seed)
    got = ours.reset(seed=seed)
    _compare_frame(expected[0], got[0], f'{name}, first frame', found)
    _check(expected[1] == got[1], f'{name}, info of reset', found)
    driver = Driver(ours, style, seed)
    off_road = 0
    # The frame that `reset` draws is one of them.
    while ours.facts().frames < limit - 1:
        action = driver.act()
        got_frame, got_total, got_terminated, got_truncated, got_info = ours.step(action)
        held = got_info.pop('frames', 1)
        facts = ours.facts()
        where = f'{name}, frame {facts.frames}'
        total = 0.0
        for step in range(held):
            # Stock frames that ours has not drawn need not be drawn either.
            core._render = drawing if step == held - 1 else _draw_nothing
            frame, reward, terminated, truncated, info = stock.step(action)
            total = total + reward if step else reward
            found.simulated += 1
            if terminated or truncated:
                break
        _check(step == held - 1, f'{where}: the episode ended earlier', found)
        _check(total == got_total, f'{where}: reward {total} and {got_total}', found)
        _check(
            (terminated, truncated, info) == (got_terminated, got_truncated, got_info),
            f'{where}: end or info',
            found,
        )
        _compare_frame(frame, got_frame, where, found)
        off_road = off_road + held if facts.wheels_off_road == _OFF_ROAD else 0
        turning = abs(ours.simulation.car.hull.angularVelocity)
        found.variety['zooming in'] += facts.frames < 50
        found.variety['off the road'] += facts.wheels_off_road == _OFF_ROAD
        found.variety['far off the road'] += off_road > _FAR_OFF_ROAD_FRAMES
        found.variety['at speed'] += facts.speed > _AT_SPEED
        found.variety['spinning'] += turning > _SPINNING
        found.variety['action repeat'] += ours.action_repeat > 1
        found.variety['other colours'] += bool(ours.simulation.domain_randomize)
        if terminated or truncated:
            found.variety['laps finished'] += bool(info.get('lap_finished', False))
            found.variety['left the playfield'] += info.get('lap_finished', True) is False
            found.variety['out of time'] += truncated
            break


def _draw_nothing(mode: str) -> None:
    """Stand for gymnasium's drawing."""


def _compare_frame(
    expected: np.ndarray | None, got: np.ndarray, where: str, found: Fidelity
) -> None:
    """Compare one frame with its reference."""
    found.frames += 1
    same = expected is not None and expected.dtype == got.dtype and np.array_equal(expected, got)
    _check(same, f'{where}: pixels', found)


def _check(same: bool, what: str, found: Fidelity) -> None:
    """Count a difference unless `same`."""
    if not same:
        found.differences += 1
        found.first_difference = found.first_difference or what
