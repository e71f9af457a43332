# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Shaping: what training adds to the reward of the environment, as named, weighted terms.

Every term is a function of the `step` fields of two neighbouring frames, so one recording can be
learned from with any shaping. With all weights at zero the reward is the environment's own.
"""
from __future__ import annotations

from collections import defaultdict
import math

from msgs_bridge.step import Step
from trainer_node.hyperparameters import Hyperparameters


def shaping_terms(
    settings: Hyperparameters, step: Step, previous_step: Step,
) -> dict[str, float]:
    """
    Return the points of each term for one transition.

    Args:
        settings: the weights.
        step: of the frame after the action.
        previous_step: of the frame before it.

    Returns:
        Points by name; the sum is added to the reward.
    """
    info, previous = defaultdict(float, step.info), defaultdict(float, previous_step.info)
    frames = info['frames']
    missed = info['tiles_missed'] - previous['tiles_missed']
    visited = info['tiles_visited'] - previous['tiles_visited']
    came_round = info['came_round']
    driven = info['lap_position'] - previous['lap_position']
    tiles = max(info['tiles_total'], 1.0)
    return {
        # a tile that is fetched later gives its points back
        'tile_missed': -min(
            settings.tile_missed_penalty * missed, settings.tile_missed_limit),
        'off_road': -settings.off_road_penalty * info['wheels_off_road'] * frames,
        'standing': -standing_points(settings, int(info['standing_still']), int(frames)),
        'progress': settings.progress_weight * visited / tiles,
        'position': settings.position_weight * driven / tiles,
        'speed': settings.speed_weight * info['speed'] / 100 * frames,
        'time': -settings.time_penalty * frames,
        'finish': settings.finish_bonus * max(info['lap_finished'], came_round),
        'left_field': settings.left_field_refund * info['left_field'],
        'early_end': -settings.early_end_penalty * info['ended_early'] * (1 - came_round),
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


def shaped_reward(settings: Hyperparameters, step: Step, previous: Step) -> float:
    """Return what is learned from: the environment's reward and all terms, scaled."""
    terms = shaping_terms(settings, step, previous)
    return settings.reward_scale * (step.reward + math.fsum(terms.values()))
