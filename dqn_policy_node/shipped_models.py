# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Models by name: a path, or one of those that come with the package."""
from __future__ import annotations

import os
from pathlib import Path

from dqn_policy_node.errors import ModelError
from msgs_bridge.share import share_folders, share_path

RANDOM = 'random'
"""In place of a model: uniform random actions, the dummy agent."""

MAX_SHOWN = 100
"""Characters of a name that an error quotes."""


def find_model(name_or_path: Path | str, base: Path | str = '') -> Path:
    """
    Return the folder of a model: a path, or the name of one that comes with the package.

    Args:
        name_or_path: which.
        base: folder that a relative path counts from; the working folder by default.

    Raises:
        ModelError: there is neither.
    """
    path = Path(base) / Path(os.path.expanduser(name_or_path))
    # a name may be none that a file can have
    if os.path.isfile(path / 'model.json'):
        return path
    shipped = shipped_models()
    if str(name_or_path) in shipped:
        return share_path(Path('models') / name_or_path)
    raise ModelError(
        f'no model {str(name_or_path)[:MAX_SHOWN]!r}: neither a folder with model.json nor one of '
        f'the shipped, which are {", ".join(shipped) or "none"}')


def shipped_models() -> list[str]:
    """Return the names of the models that come with the package."""
    return sorted({path.parent.name for folder in share_folders()
                   for path in folder.glob('models/*/model.json')})
