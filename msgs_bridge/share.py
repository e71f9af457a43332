# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where the files are that come with the package: models, presets and the DDS profile."""
from __future__ import annotations

import os
from pathlib import Path
import sys

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
