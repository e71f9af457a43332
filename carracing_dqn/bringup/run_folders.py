# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Folders that commands write to."""
from __future__ import annotations

from pathlib import Path
import shlex
import time

from msgs_bridge.errors import BridgeError

LOGS = 'log'


def shell_word(path: Path) -> str:
    """Return a path as it may be pasted into a shell, where it is no option either."""
    text = str(path)
    return shlex.quote(f'./{text}' if text.startswith('-') else text)


def default_folder(prefix: str) -> Path:
    """Return the output folder of a run for which none was named, below `runs`."""
    return Path('runs') / f'{prefix}-{time.strftime("%Y%m%d-%H%M%S")}'


def new_folder(path: Path, *, begun: bool = False) -> Path:
    """
    Make the output folder of a run, with a folder for logs in it, and return it.

    Args:
        path: the folder.
        begun: whether it may be there already, with a run that goes on.

    Raises:
        BridgeError: it exists already or cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=begun)
        (path / LOGS).mkdir(exist_ok=begun)
    except FileExistsError:
        raise BridgeError(f'{path} exists already; choose another folder') from None
    except OSError as error:
        raise BridgeError(f'{path} cannot be made: {error.strerror}') from None
    return path
