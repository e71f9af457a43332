# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Folders in which only the user can write, for files that are trusted when read again."""
from __future__ import annotations

import os
from pathlib import Path
import stat
import tempfile

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def user_cache_folder() -> Path:
    """Return the user's cache folder as the XDG base directories have it; it may not exist."""
    given = Path(os.environ.get('XDG_CACHE_HOME', ''))
    return given if given.is_absolute() else Path.home() / '.cache'


def make_private(folder: Path) -> Path:
    """
    Make a folder in which nobody but its user (and root) can write or put other folders in place.

    Returns:
        Its path without links.

    Raises:
        OSError: it cannot be made or written, or others could write in it or replace it.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = folder.resolve()
    _check(folder, os.stat(folder), sticky_counts=False)
    for parent in folder.parents:
        _check(parent, os.stat(parent), sticky_counts=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f'{folder} is not writable')
    return folder


def make_temporary(name: str) -> Path:
    """
    Make a private folder among the temporary ones, for a user without a home.

    Raises:
        OSError: it cannot be made, or somebody else has made it.
    """
    folder = Path(tempfile.gettempdir()) / f'{name}_{os.getuid()}'
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise PermissionError(f'{folder} is a link or belongs to another user')
    return make_private(folder)


def _check(folder: Path, status: os.stat_result, *, sticky_counts: bool) -> None:
    if status.st_uid not in (0, os.getuid()):
        raise PermissionError(f'{folder} belongs to another user')
    # in a folder like /tmp others may write, but not replace what is not theirs
    safe = sticky_counts and status.st_mode & stat.S_ISVTX
    if status.st_mode & WRITABLE_BY_OTHERS and not safe:
        raise PermissionError(f'{folder} is writable by others')
