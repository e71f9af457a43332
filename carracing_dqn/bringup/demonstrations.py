# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations out of bags, for `carracing train --demonstrations`."""
from __future__ import annotations

from pathlib import Path

from bags.transitions import bag_transitions
from trainer_node.demonstrations import collect, Demonstrations
from trainer_node.hyperparameters import Hyperparameters


def demonstrations_from(
    bags: list[Path], settings: Hyperparameters, namespace: str = '',
) -> Demonstrations:
    """
    Return what bags hold, whoever drove.

    Args:
        bags: bag folders or files, in order.
        settings: of the run that is to learn from them.
        namespace: where the topics of the car are; needed if there are several.

    Raises:
        BagError: a bag that cannot be read, or lacks images or steps.
        LearningError: nothing in them can be learned from.
    """
    return collect(settings, bag_transitions(bags, namespace=namespace),
                   [bag.resolve().name for bag in bags])
