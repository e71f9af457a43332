# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Laps over topics in a namespace of their own, for `carracing evaluate --through-graph`."""
from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import tempfile
import time

from carracing_dqn.bringup.models import action_repeat, RANDOM
from carracing_dqn.bringup.monitor import Monitor
from carracing_dqn.bringup.processes import node_command, ProcessGroup
from carracing_dqn.bringup.provenance import provenance_text
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
        BridgeError: a node died, or the bag folder is there already.
    """
    if bag is not None and bag.exists():
        raise BridgeError(f'{bag} exists already; choose another folder for the bag')
    simulator: dict[str, object] = {
        'seed': seeds.start, 'seed_each_episode': True, 'episodes': len(seeds),
        'action_repeat': action_repeat(model),
        'wait_for_subscribers': 0 if bag is None else 1,
    }
    policy: dict[str, object] = {
        'model': model, 'hot_swap': False, 'wait_for_subscribers': 1 if bag is None else 2}
    if model == RANDOM:
        policy['seed'] = seeds.start
    space = f'evaluate_{os.getpid()}'
    monitor = Monitor(space)
    try:
        with tempfile.TemporaryDirectory() as logs, ProcessGroup(Path(logs)) as group:
            if bag is not None:
                group.start('recorder', node_command('bags.recorder_node', {
                    'folder': str(bag),
                    'provenance': provenance_text(simulator=simulator, policy=policy)}, space))
            group.start('policy', node_command('dqn_policy_node', policy, space))
            group.start('simulator', node_command('carracing_sim_node', simulator, space))
            yield from _summaries(group, monitor, len(seeds))
    finally:
        monitor.close()


def _summaries(
    group: ProcessGroup, monitor: Monitor, wanted: int,
) -> Iterator[dict[str, float]]:
    """Yield summaries as they come, until all are there or the simulator has long ended."""
    give_up_at = None
    while wanted:
        while monitor.state.episodes:
            yield monitor.state.episodes.popleft()
            wanted -= 1
        if give_up_at is None and group.check() is not None:
            give_up_at = time.monotonic() + LAST_SUMMARY_SECONDS
        if give_up_at is not None and time.monotonic() > give_up_at:
            return
        time.sleep(0.02)
