# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What is made of samples beyond what was seen: other brightness, left for right."""
from __future__ import annotations

import numpy as np

from dqn_policy_node.action_space import action_space
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.replay_buffer import Batch


def augment(batch: Batch, settings: Hyperparameters, random: np.random.Generator) -> Batch:
    """
    Return a batch with what `flips` and `brightness` ask for; its arrays are changed in place.

    Args:
        batch: samples; both observations of one are changed alike.
        settings: of the run.
        random: draws for each sample.
    """
    count = len(batch.actions)
    if settings.flips:
        flipped = random.random(count) < 0.5
        mirror = action_space(settings.action_space).mirror
        batch.actions[flipped] = mirror(batch.actions[flipped])
        for observations in (batch.observations, batch.next_observations):
            observations[flipped] = observations[flipped][..., ::-1]
    if settings.brightness:
        factors = 1.0 + random.uniform(-settings.brightness, settings.brightness, (count, 1))
        levels = np.rint(np.minimum(factors * np.arange(256), 255)).astype(np.uint8)
        for observations in (batch.observations, batch.next_observations):
            # in the order in which they lie in memory
            for own, stack in zip(levels, observations.transpose(0, 2, 3, 1)):
                stack[...] = own[stack]
    return batch
