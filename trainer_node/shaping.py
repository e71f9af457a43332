# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Shaping: what training adds to the reward of the environment, as named, weighted terms.

Every term is a function of the `step` fields of two neighbouring frames, so one recording can be
learned from with any shaping. With all weights at zero the reward is the environment's own.
"""
from __future__ import annotations

import math

from trainer_node.hyperparameters import Hyperparameters

Facts = dict[str, float]


def shaping_terms(settings: Hyperparameters, facts: Facts, previous: Facts) -> dict[str, float]:
    """
    Return the points of each term for one transition.

    Args:
        settings: the weights.
        facts: `step` fields of the frame after the action.
        previous: `step` fields of the frame before it.

    Returns:
        Points by name; the sum is added to the reward.
    """
    frames = facts['frames']
    missed = facts['tiles_missed'] - previous['tiles_missed']
    visited = facts['tiles_visited'] - previous['tiles_visited']
    # bags of before these fields have none
    came_round = facts.get('came_round', 0.0)
    driven = facts.get('lap_position', 0.0) - previous.get('lap_position', 0.0)
    tiles = max(facts['tiles_total'], 1.0)
    return {
        # a tile that is fetched later gives its points back
        'tile_missed': -min(
            settings.tile_missed_penalty * missed, settings.tile_missed_limit),
        'off_road': -settings.off_road_penalty * facts['wheels_off_road'] * frames,
        'standing': -standing_points(settings, int(facts['standing_still']), int(frames)),
        'progress': settings.progress_weight * visited / tiles,
        'position': settings.position_weight * driven / tiles,
        'speed': settings.speed_weight * facts['speed'] / 100 * frames,
        'time': -settings.time_penalty * frames,
        'finish': settings.finish_bonus * max(facts['lap_finished'], came_round),
        'left_field': settings.left_field_refund * facts['left_field'],
        'early_end': -settings.early_end_penalty * facts['ended_early'] * (1 - came_round),
    }


def standing_points(settings: Hyperparameters, standing: int, frames: int) -> float:
    """
    Return the penalty for standing still: growing exponentially with its time (report, 5.1).

    Args:
        settings: weight of the first frame, growth for each further one, and the most for one.
        standing: frames in a row that the car has stood still.
        frames: how many of them are new.
    """
    weight, growth = settings.standing_penalty, settings.standing_growth
    if weight == 0 or standing == 0:
        return 0.0
    limit = settings.standing_limit
    # beyond this exponent the limit holds anyway, and a float may overflow
    highest = math.log(max(limit / weight, 1.0)) / math.log(growth) if growth > 1 else math.inf
    return sum(
        min(weight * growth ** min(frame, highest), limit)
        for frame in range(max(standing - frames, 0), standing))


def shaped_reward(settings: Hyperparameters, facts: Facts, previous: Facts) -> float:
    """Return what is learned from: the environment's reward and all terms, scaled."""
    terms = shaping_terms(settings, facts, previous)
    return settings.reward_scale * (facts['reward'] + math.fsum(terms.values()))
