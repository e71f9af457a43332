# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Folders that commands write to."""
from __future__ import annotations

from pathlib import Path
import time

from msgs_bridge.errors import BridgeError

LOGS = 'log'


def default_folder(prefix: str) -> Path:
    """Return the output folder of a run for which none was named, below `runs`."""
    return Path('runs') / f'{prefix}-{time.strftime("%Y%m%d-%H%M%S")}'


def new_folder(path: Path) -> Path:
    """
    Make the output folder of a run, with a folder for logs in it.

    Raises:
        BridgeError: it exists already or cannot be made.
    """
    try:
        path.mkdir(parents=True)
        (path / LOGS).mkdir()
    except FileExistsError:
        raise BridgeError(f'{path} exists already; choose another folder') from None
    except OSError as error:
        raise BridgeError(f'{path} cannot be made: {error.strerror}') from None
    return path


def reopened_folder(path: Path) -> Path:
    """
    Return the folder of a run that goes on, after a look whether it can be written.

    Raises:
        BridgeError: it cannot.
    """
    try:
        (path / LOGS).mkdir(exist_ok=True)
        probe = path / LOGS / '.writable'
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise BridgeError(f'{path} cannot be written: {error.strerror}') from None
    return path
