# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where the files are that come with the package: models and presets."""
from __future__ import annotations

import os
from pathlib import Path
import sys

from dqn_policy_node.errors import ModelError

PACKAGE = 'carracing_dqn'


def share_folders() -> list[Path]:
    """Return the folders to look in, first the installed ones that ROS knows of."""
    folders = [
        Path(prefix) / 'share' / PACKAGE
        for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
    folders.append(Path(sys.prefix) / 'share' / PACKAGE)
    # the source tree: a checkout, or an install that links to one
    folders.append(Path(__file__).resolve().parent.parent)
    return folders


def share_path(relative: Path | str) -> Path:
    """
    Return a file or folder that comes with the package.

    Raises:
        FileNotFoundError: it is in none of the places; the text names them.
    """
    for folder in share_folders():
        if (folder / relative).exists():
            return folder / relative
    places = ', '.join(map(str, share_folders()))
    raise FileNotFoundError(f'{relative} is in none of {places}')


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
                         'the models of the package') from None
