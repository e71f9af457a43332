# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Models by name: a path, or one of those that come with the package."""
from __future__ import annotations

from pathlib import Path

from dqn_policy_node.errors import ModelError
from msgs_bridge.share import share_path


def find_model(name_or_path: Path | str) -> Path:
    """
    Return the folder of a model: a path, or the name of one that comes with the package.

    Raises:
        ModelError: there is neither.
    """
    path = Path(name_or_path).expanduser()
    if (path / 'model.json').is_file():
        return path
    try:
        return share_path(Path('models') / name_or_path)
    except FileNotFoundError:
        raise ModelError(f'no model folder {str(name_or_path)!r}, neither as a path nor among '
                         f'the models of the package, which are {_shipped()}') from None


def _shipped() -> str:
    try:
        folders = share_path('models').iterdir()
    except FileNotFoundError:
        return 'none'
    return ', '.join(sorted(folder.name for folder in folders if folder.is_dir()))
