# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Models by name, as the commands take them and as nodes and recordings are told of them."""
from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from msgs_bridge.simulator import FRAME_SECONDS
from dqn_policy_node.shipped_models import find_model, RANDOM
from msgs_bridge.errors import BridgeError
from msgs_bridge.share import share_path

BEST_FIRST = ('racing', 'report')
"""Shipped models, in the order in which `carracing run` looks for one."""


def choose_model(name: str | None) -> str:
    """
    Return the model to drive with: a folder, or 'random'.

    Raises:
        BridgeError: the model asked for is not there.
    """
    if name == RANDOM:
        return name
    if name is not None:
        # a folder that is called random is no dummy agent
        path = str(find_model(name))
        return os.path.join('.', path) if path == RANDOM else path
    for candidate in BEST_FIRST:
        with contextlib.suppress(BridgeError):
            return str(find_model(candidate))
    return RANDOM


def action_repeat(model: str, frame_seconds: float = FRAME_SECONDS) -> int:
    """
    Return how many frames of some seconds a simulator may drive by one twist of a model.

    Raises:
        BridgeError: the model folder cannot be used.
    """
    if model == RANDOM:
        return 1
    from dqn_policy_node.model_folder import load_model
    return max(1, round(load_model(model).description.action_seconds / frame_seconds))


def as_parameter(model: str, folder: Path | str) -> str:
    """
    Return a model as a node is told of it: by name if it is shipped, else its path.

    Args:
        model: a folder, or 'random'.
        folder: current folder of the node. Paths are relative to it, because they are logged and
            logs are recorded: a shared bag should not tell whose home it comes from.
    """
    if model == RANDOM:
        return model
    name = Path(model).name
    with contextlib.suppress(OSError):
        # a node takes a folder of that name where it is, and only then a shipped model
        if share_path(Path('models') / name).samefile(model) and not os.path.lexists(
                Path(folder) / name):
            return name
    path = os.path.relpath(os.path.realpath(model), os.path.realpath(folder))
    # alone it could be the name of a shipped model, or random
    return path if os.sep in path else os.path.join('.', path)


def identity(model: str) -> dict[str, Any]:
    """
    Return what tells a model from others, for the record, without the place where it lies.

    Raises:
        BridgeError: the model folder cannot be used.
    """
    if model == RANDOM:
        return {'name': RANDOM}
    import hashlib

    from dqn_policy_node.model_folder import load_model, WEIGHTS_FILE
    loaded = load_model(model)
    weights = (Path(model) / WEIGHTS_FILE).read_bytes()
    return {
        'name': Path(model).resolve().name, 'version': loaded.version,
        'weights_sha256': hashlib.sha256(weights).hexdigest(),
        'description_sha256': loaded.description.sha256()}
