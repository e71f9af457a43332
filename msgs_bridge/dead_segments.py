# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Removes what killed processes have left of Fast DDS in shared memory, half a megabyte each."""
from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
import re
import time

SHARED_MEMORY = Path('/dev/shm')

# A living process keeps its segment's lock file locked; the kernel unlocks it with the process.
LOCK_FILE = re.compile('(fastrtps_[0-9a-f]{16})_el')

# between making a lock file and locking it a process may be slow, but not for so many seconds
OLD_ENOUGH = 60.0


def remove_dead_segments(folder: Path = SHARED_MEMORY, *, old_enough: float = OLD_ENOUGH) -> int:
    """
    Remove this user's segments whose process is gone.

    Args:
        folder: where shared memory is.
        old_enough: least age of a segment in seconds.

    Returns:
        How many were removed. What cannot be read or removed stays.
    """
    removed = 0
    # one by one: another process may be at the same
    for path in _entries(folder):
        name = LOCK_FILE.fullmatch(path.name)
        with contextlib.suppress(OSError):
            if name and _is_dead(path, old_enough):
                (folder / name[1]).unlink(missing_ok=True)
                path.unlink()
                removed += 1
    return removed


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _is_dead(lock: Path, old_enough: float) -> bool:
    """Return whether nobody holds a lock file; raises OSError where that cannot be told."""
    status = lock.lstat()
    if status.st_uid != os.getuid() or time.time() - status.st_mtime < old_enough:
        return False
    with open(os.open(lock, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return True
