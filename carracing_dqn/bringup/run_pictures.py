# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A picture of every recorded lap, driven again in this process from its bag."""
from __future__ import annotations

from pathlib import Path

from bags.transitions import bag_transitions
from carracing_dqn.evaluation.lap_picture import draw_lap
from carracing_dqn.evaluation.trajectory import RecordedActions


def draw_recorded_laps(bag: Path, folder: Path) -> list[Path]:
    """
    Draw the whole laps of a bag; return the pictures.

    Args:
        bag: bag whose tracks have a seed each.
        folder: where `lap-SEED.png` go; made if it is not there.

    Raises:
        BagError: the bag cannot be read.
    """
    folder.mkdir(exist_ok=True)
    pictures: list[Path] = []
    actions: list[tuple[float, float, float]] = []
    for transition in bag_transitions([bag]):
        facts = transition.info
        if transition.previous_info['decision'] == 0:
            actions = []
        # what was applied, held for as many frames as the simulator drove
        actions += [(facts['steer'], facts['gas'], facts['brake'])] * int(facts['frames'])
        whole = (transition.terminated or transition.truncated) and len(actions) == facts['step']
        if whole and facts['seed'] >= 0:
            path = folder / f'lap-{facts["seed"]:.0f}.png'
            draw_lap(RecordedActions(actions), int(facts['seed']), path)
            pictures.append(path)
    return pictures
