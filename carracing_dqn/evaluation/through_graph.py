# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The same laps over the ROS graph: simulator and policy as processes, in lockstep.

What starts the nodes is handed in, because this package knows none of the others that do. Frames
and actions are the same to the byte as in process, and so are the laps.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
import time

from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.laps import Lap, lap_of, MAX_FRAMES
from carracing_dqn.evaluation.policies import MODEL, PolicySource
from dqn_policy_node.shipped_models import RANDOM

RunGraph = Callable[[str, range, 'Path | None'], Iterator[Mapping[str, float]]]
"""
Drives a model (folder, or 'random' with the seed of its track) over topics.

Takes the model, consecutive seeds of tracks and a folder for a bag or None; yields the summary of
every episode, `episode` message, as it ends.
"""


def drive_laps_through_graph(
    source: PolicySource, seeds: Sequence[int], run_graph: RunGraph, *, bag: Path | None = None,
) -> Iterator[Lap]:
    """
    Drive one lap a seed over topics and yield each as it ends, in order.

    Args:
        source: a model, or the dummy agent.
        seeds: seeds of the tracks, rising.
        run_graph: starts the nodes.
        bag: folder of a new bag of everything, or None.

    Raises:
        EvaluationError: a policy that no node can drive, a bag of more than one run of the
            graph, an episode that is missing or another than asked for, or a model that was
            replaced meanwhile.
        BridgeError: what `run_graph` raises.
    """
    if source.kind not in (MODEL, RANDOM):
        raise EvaluationError(
            f'policy {source.kind!r} is no node; --through-graph drives models and random')
    # the dummy agent starts its draws anew with every lap, which a node does when it starts
    stretches = [range(seed, seed + 1) for seed in seeds] if source.kind == RANDOM \
        else consecutive(seeds)
    if bag is not None and len(stretches) > 1:
        raise EvaluationError(
            f'--bag holds one run of the graph, but these laps need {len(stretches)}; evaluate '
            'one lap of random at a time, and models without laps that are there already')
    model = RANDOM if source.kind == RANDOM else source.model
    for stretch in stretches:
        expected = iter(stretch)
        before = time.perf_counter()
        for summary in run_graph(model, stretch, bag):
            seed = next(expected, None)
            if summary['seed'] != seed:
                raise EvaluationError(
                    f'the graph drove track {summary["seed"]:.0f}; expected {seed}')
            frames = summary.get('step', 0.0)
            # written so that NaN fails, too
            if not 1 <= frames <= MAX_FRAMES:
                raise EvaluationError(f'the graph says that track {seed} took {frames:g} frames')
            # its node has loaded the model by now
            source.check()
            now = time.perf_counter()
            yield lap_of(
                seed, float(summary['episode_return']), int(frames), summary, now - before)
            before = now
        missing = next(expected, None)
        if missing is not None:
            raise EvaluationError(f'the graph ended before it had driven track {missing}')


def consecutive(seeds: Sequence[int]) -> list[range]:
    """Return rising seeds as stretches without gaps."""
    stretches: list[range] = []
    for seed in seeds:
        if stretches and stretches[-1].stop == seed:
            stretches[-1] = range(stretches[-1].start, seed + 1)
        else:
            stretches.append(range(seed, seed + 1))
    return stretches
