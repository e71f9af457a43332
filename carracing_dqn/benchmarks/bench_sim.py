# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`carracing bench sim`: how fast the simulator is, and whether it still equals gymnasium's.

Stock gymnasium, EnvPool (if it is installed) and ours drive the same recorded laps in turn, one
after the other in every round, on one core each; the figures are medians over the rounds, and
ratios are taken within a round. Resets are timed apart.
"""

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
from statistics import median
import sys
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np
from rich.console import Console
from rich.table import Table

from carracing_dqn.benchmarks.driver import Driver
from carracing_dqn.benchmarks.fidelity import Fidelity
from carracing_dqn.benchmarks.fidelity import compare
from carracing_sim_node import make_env
from carracing_sim_node.guard import surroundings

GROUP = 4
"""Frames for which every recorded action is held, and the action repeat that is measured."""

DEFAULT_ROUNDS = 5
DEFAULT_FRAMES = 2000
DEFAULT_RESETS = 200
_FIRST_SEED = 1000
_WARM_UP_FRAMES = 60

Lap = tuple[int, list[np.ndarray]]
"""A seed and one action for every group of frames."""


def run(
    *,
    rounds: int = DEFAULT_ROUNDS,
    frames: int = DEFAULT_FRAMES,
    resets: int = DEFAULT_RESETS,
    lap_frames: int = 1000,
    on_fidelity: Callable[[Fidelity], None] | None = None,
) -> dict[str, Any]:
    """
    Measure speed, compare frames and watch the memory.

    Args:
        rounds: Rounds of the speed measurement; each drives one lap with everything.
        frames: Frames to compare byte for byte with stock gymnasium; 0 compares none.
        resets: Resets of ours over which the memory is watched.
        lap_frames: Frames per lap, at most.
        on_fidelity: Called with the findings so far after every compared episode.

    Returns:
        What `show` prints, made of what JSON knows.
    """
    laps = [_record(_FIRST_SEED + i, lap_frames) for i in range(rounds)]
    contestants = _contestants()
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    reset_seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for drive in contestants.values():
        drive((laps[0][0], laps[0][1][: _WARM_UP_FRAMES // GROUP]))
    for lap in laps:
        for name, drive in contestants.items():
            reset_time, drive_time, driven = drive(lap)
            reset_seconds[name].append(reset_time)
            seconds[name].append(drive_time / driven)
    speed = {
        name: {
            'frames_per_second': 1.0 / median(seconds[name]),
            'ratio': median(stock / own for stock, own in zip(seconds['stock'], seconds[name])),
            'resets_per_second': 1.0 / median(reset_seconds[name]),
        }
        for name in contestants
    }
    found = compare(frames, on_progress=on_fidelity) if frames else Fidelity()
    return {
        'surroundings': surroundings()._asdict(),
        'rounds': rounds,
        'cores': os.cpu_count(),
        'load_average': os.getloadavg()[0] if hasattr(os, 'getloadavg') else None,
        'speed': speed,
        'fidelity': {
            'frames_compared': found.frames,
            'frames_simulated': found.simulated,
            'episodes': found.episodes,
            'differences': found.differences,
            'first_difference': found.first_difference,
            'variety': dict(found.variety),
        },
        'memory': _watch_memory(resets),
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print what `run` returned."""
    here = result['surroundings']
    table = Table(
        title=f'CarRacing-v3 (gymnasium {here["gymnasium"]}, pygame-ce {here["pygame"]}), '
        f'one core each, median of {result["rounds"]} rounds'
    )
    for column in ('simulator', 'frames/s', 'to stock', 'resets/s'):
        table.add_column(column, justify='left' if column == 'simulator' else 'right')
    for name, figures in result['speed'].items():
        table.add_row(
            name,
            f'{figures["frames_per_second"]:,.0f}',
            f'{figures["ratio"]:.1f}x',
            f'{figures["resets_per_second"]:,.0f}',
        )
    console.print(table)
    if 'EnvPool' not in result['speed']:
        console.print('EnvPool is not installed (pip install envpool).')
    fidelity = result['fidelity']
    console.print(
        f'{fidelity["frames_compared"]:,} frames of {fidelity["episodes"]:,} episodes compared '
        f"byte for byte with gymnasium's, {fidelity['frames_simulated']:,} rewards, ends and "
        f'infos: {fidelity["differences"]:,} differ.'
    )
    if fidelity['first_difference']:
        console.print(f'The first: {fidelity["first_difference"]}')
    if fidelity['variety']:
        kinds = ', '.join(f'{count:,} {kind}' for kind, count in fidelity['variety'].items())
        console.print(f'Among them {kinds}.')
    memory = result['memory']
    if memory['grown_mb'] is not None:
        console.print(
            f'Memory over {memory["resets"]:,} resets: {memory["start_mb"]:.1f} to '
            f'{memory["end_mb"]:.1f} MB ({memory["grown_mb"]:+.1f}).'
        )


def main(argv: list[str] | None = None) -> int:
    """
    Run the benchmark from a command line.

    Args:
        argv: Arguments; None takes the process's own.

    Returns:
        0, or 1 if any frame, reward, end or info differed.
    """
    parser = argparse.ArgumentParser(prog='carracing bench sim', description=__doc__)
    parser.add_argument(
        '--rounds', type=_positive, default=DEFAULT_ROUNDS, help='laps per simulator'
    )
    parser.add_argument(
        '--frames',
        type=int,
        default=DEFAULT_FRAMES,
        help='frames to compare byte for byte; the full proof is 100000',
    )
    parser.add_argument(
        '--resets',
        type=_positive,
        default=DEFAULT_RESETS,
        help='resets over which to watch the memory; the full proof is 10000',
    )
    parser.add_argument('--json', type=Path, help='also write everything to this file')
    arguments = parser.parse_args(argv)
    console = Console()
    with console.status('driving') as status:

        def tell(found: Fidelity) -> None:
            status.update(f'{found.frames:,} of {arguments.frames:,} frames compared')

        result = run(
            rounds=arguments.rounds,
            frames=arguments.frames,
            resets=arguments.resets,
            on_fidelity=tell,
        )
    show(result, console)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + '\n')
    return 1 if result['fidelity']['differences'] else 0


def _positive(text: str) -> int:
    """Return a whole number of at least 1 from a command line."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'{value} is not at least 1')
    return value


def _record(seed: int, lap_frames: int) -> Lap:
    """Drive a lap undrawn and return its actions, each held for `GROUP` frames."""
    env = make_env(renderer='fast', action_repeat=GROUP, max_episode_steps=lap_frames)
    env.reset(seed=seed)
    driver = Driver(env, 'lap', seed)
    actions = []
    ended = False
    while not ended:
        actions.append(driver.act())
        _, _, terminated, truncated, _ = env.step(actions[-1], draw=False)
        ended = terminated or truncated
    return seed, actions


def _contestants() -> dict[str, Callable[[Lap], tuple[float, float, int]]]:
    """Return what is measured: each drives a lap and returns its times and frames."""
    contestants = {'stock': _gymnasium_like(gymnasium.make('CarRacing-v3'), 1)}
    envpool = _envpool()
    if envpool is not None:
        contestants['EnvPool'] = envpool
    contestants['ours'] = _gymnasium_like(make_env(renderer='fast'), 1)
    contestants[f'ours, action repeat {GROUP}'] = _gymnasium_like(
        make_env(renderer='fast', action_repeat=GROUP), GROUP
    )
    return contestants


def _gymnasium_like(env: Any, repeat: int) -> Callable[[Lap], tuple[float, float, int]]:
    """Return how to drive a lap with gymnasium's interface."""

    def drive(lap: Lap) -> tuple[float, float, int]:
        seed, actions = lap
        start = perf_counter()
        env.reset(seed=seed)
        ready = perf_counter()
        frames = 0
        for action in actions:
            for _ in range(GROUP // repeat):
                _, _, terminated, truncated, info = env.step(action)
                frames += info.get('frames', 1)
                if terminated or truncated:
                    return ready - start, perf_counter() - ready, frames
        return ready - start, perf_counter() - ready, frames

    return drive


def _envpool() -> Callable[[Lap], tuple[float, float, int]] | None:
    """Return how to drive a lap with a single environment of EnvPool, if it is installed."""
    try:
        import envpool
    except ImportError:
        return None

    def drive(lap: Lap) -> tuple[float, float, int]:
        seed, actions = lap
        env = envpool.make('CarRacing-v3', env_type='gymnasium', num_envs=1, seed=seed)
        start = perf_counter()
        env.reset()
        ready = perf_counter()
        frames = 0
        for action in actions:
            for _ in range(GROUP):
                # EnvPool's track is another one, so the car may end elsewhere; it then resets
                # by itself and drives on.
                env.step(action[None])
                frames += 1
        return ready - start, perf_counter() - ready, frames

    return drive


def _watch_memory(resets: int) -> dict[str, float | int | None]:
    """Return how much memory the process has before and after `resets` short episodes."""
    env = make_env(renderer='fast')
    action = np.array([0.1, 0.5, 0.0], np.float32)

    def drive(episodes: int) -> None:
        for _ in range(episodes):
            env.reset()
            for _ in range(3):
                env.step(action)

    env.reset(seed=_FIRST_SEED)
    # The first episodes still fill caches and the allocator's pools.
    drive(min(resets, 100))
    start = _resident_mb()
    drive(resets)
    end = _resident_mb()
    grown = None if start is None or end is None else end - start
    return {'resets': resets, 'start_mb': start, 'end_mb': end, 'grown_mb': grown}


def _resident_mb() -> float | None:
    """Return the memory that this process holds, in MB, where the system tells it."""
    try:
        pages = int(Path('/proc/self/statm').read_text().split()[1])
    except OSError:
        return None
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


if __name__ == '__main__':
    sys.exit(main())
