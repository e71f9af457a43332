# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Models by name, as the commands take them."""
from __future__ import annotations

from carracing_sim_node.controls import FRAME_SECONDS
from dqn_policy_node.shipped_models import find_model
from msgs_bridge.errors import BridgeError

RANDOM = 'random'
"""In place of a model: uniform random actions."""

BEST_FIRST = ('racing', 'report')
"""Shipped models, in the order in which `carracing run` looks for one."""


def choose_model(name: str | None) -> str:
    """
    Return the model to drive with, as the policy node takes it.

    Raises:
        BridgeError: the model asked for is not there.
    """
    if name == RANDOM:
        return name
    if name is not None:
        return str(find_model(name))
    for candidate in BEST_FIRST:
        try:
            return str(find_model(candidate))
        except BridgeError:
            continue
    return RANDOM


def action_repeat(model: str) -> int:
    """
    Return how many frames the simulator may drive by one twist of a model.

    Raises:
        BridgeError: the model folder cannot be used.
    """
    if model == RANDOM:
        return 1
    from dqn_policy_node.model_folder import load_model
    return round(load_model(model).description.action_seconds / FRAME_SECONDS)
