# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A picture of every recorded lap, driven again in this process from its bag."""
from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bags.transitions import bag_transitions
from carracing_dqn.evaluation.lap_picture import draw_lap
from carracing_dqn.evaluation.trajectory import RecordedActions
from msgs_bridge.twists import Command


def draw_recorded_laps(bag: Path, folder: Path) -> Iterator[Path]:
    """
    Draw the whole laps in a bag of CarRacing one by one; yield each picture.

    Args:
        bag: bag whose tracks have a seed each; others are passed over.
        folder: where `lap-SEED.png` go; made if it is not there.

    Raises:
        BagError: the bag cannot be read.
    """
    folder.mkdir(exist_ok=True)
    commands: list[Command] = []
    for transition in bag_transitions([bag]):
        step = transition.step
        if transition.previous.decision == 0:
            commands = []
        # what was applied, held for as many frames as the simulator drove
        applied = Command(step.info['linear'], step.info['angular'])
        commands += [applied] * int(step.info['frames'])
        whole = step.ended and len(commands) == step.info['step']
        if whole and step.seed >= 0:
            path = folder / f'lap-{step.seed}.png'
            draw_lap(RecordedActions(commands), step.seed, path)
            yield path
