# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Many laps, one a seed, in this process or in several."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import functools

from carracing_dqn.evaluation.laps import drive_lap, Lap
from carracing_dqn.evaluation.policies import PolicySource
from carracing_dqn.evaluation.simulators import make_simulator
from carracing_dqn.evaluation.workers import run_jobs


def drive_laps(
    source: PolicySource, seeds: Iterable[int], *, simulator: str = 'gymnasium',
    processes: int = 1, pictures: str | None = None,
) -> Iterator[Lap]:
    """
    Drive one lap a seed and yield each as it ends; with several processes in any order.

    What a lap gives depends on its seed alone, so the laps are the same with any number of
    processes. Leaving the iterator early stops the laps that are still being driven.

    Args:
        source: where every process gets its policy from.
        seeds: seeds of the tracks.
        simulator: see `simulators.SIMULATORS`.
        processes: 1 drives in this process.
        pictures: folder for a picture of every lap.

    Raises:
        PolicyError: the policy cannot be opened, or answered with something that is no action.
        EvaluationError: there is no such simulator, or a process died.
    """
    make_driver = functools.partial(_make_driver, source, simulator, pictures)
    if processes > 1:
        yield from run_jobs(make_driver, seeds, processes)
        return
    driver = make_driver()
    for seed in seeds:
        yield driver(seed)


def _make_driver(
    source: PolicySource, simulator: str, pictures: str | None,
) -> Callable[[int], Lap]:
    """Open policy and simulator in the process that drives; return seed -> Lap."""
    policy = source.open()

    def drive(seed: int) -> Lap:
        # a new world for every lap: Box2D keeps some tiles of the old ones in memory
        env = make_simulator(simulator)
        try:
            if pictures is None:
                return drive_lap(env, policy, seed)
            # matplotlib is slow to load and only needed here
            from carracing_dqn.evaluation.lap_picture import drive_and_draw
            return drive_and_draw(env, policy, seed, pictures)
        finally:
            env.close()

    make_simulator(simulator).close()
    return drive
