# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Many laps, one a seed, in this process or in several."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import functools

from carracing_dqn.evaluation.laps import drive_lap, Lap
from carracing_dqn.evaluation.policies import PolicySource
from carracing_dqn.evaluation.workers import run_jobs
from carracing_dqn.simulation import make_simulator


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
        simulator: name of an installed one, or module:Class.
        processes: 1 drives in this process.
        pictures: folder for a picture of every lap.

    Raises:
        PolicyError: the policy cannot be opened, or answered with something that is no action.
        SimulatorError: there is no such simulator.
        EvaluationError: a process died, or pictures of a simulator that has no track.
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
    # one world for all: what a lap gives does not depend on what was driven in it before
    made = make_simulator(simulator)
    policy = source.open(made.frame_seconds)
    if pictures is None:
        return functools.partial(drive_lap, made, policy)
    # matplotlib is slow to load and only needed here
    from carracing_dqn.evaluation.lap_picture import drive_and_draw
    return functools.partial(drive_and_draw, made, policy, folder=pictures)
