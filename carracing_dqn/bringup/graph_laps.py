# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Laps over topics in a namespace of their own, for `carracing evaluate --through-graph`."""
from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import tempfile
import time

from carracing_dqn.bringup.graph import driving_graph, Graph
from carracing_dqn.bringup.models import action_repeat, as_parameter, identity
from carracing_dqn.bringup.monitor import Monitor
from carracing_dqn.bringup.processes import ProcessGroup
from carracing_dqn.bringup.provenance import with_provenance
from carracing_dqn.bringup.supervise import check_machine, look
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge.errors import BridgeError

LAST_SUMMARY_SECONDS = 2.0
"""How long the last episode summary may take after the simulator has ended."""


def run_graph(model: str, seeds: range, bag: Path | None) -> Iterator[dict[str, float]]:
    """
    Drive one lap a seed in lockstep; yield the summary of each, an `episode` message.

    Args:
        model: model folder, or 'random', which then draws from the first seed.
        seeds: seeds of the tracks, consecutive.
        bag: folder of a new bag, or None.

    Raises:
        BridgeError: a node ended early, or the bag folder is there already or cannot be made.
    """
    if bag is not None and bag.exists():
        raise BridgeError(f'{bag} exists already; choose another folder for the bag')
    if bag is not None and not bag.parent.is_dir():
        raise BridgeError(f'{bag}: there is no folder {bag.parent}')
    check_machine()
    space = f'evaluate_{os.getpid()}'
    monitor = Monitor(space)
    try:
        with tempfile.TemporaryDirectory() as logs, ProcessGroup(Path(logs)) as group:
            folder = Path(logs) if bag is None else bag.resolve().parent
            group.start_graph(_graph(model, seeds, bag, folder), space, folder)
            yield from _summaries(group, monitor, len(seeds))
            group.stop()
            group.check_ends()
    finally:
        monitor.close()


def _graph(model: str, seeds: range, bag: Path | None, folder: Path) -> Graph:
    policy: dict[str, object] = {'hot_swap': False}
    if model == RANDOM:
        policy['seed'] = seeds.start
    return with_provenance(driving_graph(
        model=as_parameter(model, folder), seed=seeds.start, episodes=len(seeds),
        action_repeat=action_repeat(model), policy=policy,
        bag=None if bag is None else bag.name), model=identity(model))


def _summaries(
    group: ProcessGroup, monitor: Monitor, wanted: int,
) -> Iterator[dict[str, float]]:
    """Yield summaries as they come, until all are there or the simulator has long ended."""
    give_up_at = None
    while wanted:
        while monitor.state.episodes:
            yield monitor.state.episodes.popleft()
            wanted -= 1
        if give_up_at is None and look(group, monitor) is not None:
            give_up_at = time.monotonic() + LAST_SUMMARY_SECONDS
        if give_up_at is not None and time.monotonic() > give_up_at:
            return
        time.sleep(0.02)
