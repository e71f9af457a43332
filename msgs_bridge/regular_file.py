# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Reading files that somebody else may have put there."""
from __future__ import annotations

import os
from pathlib import Path
import stat

from msgs_bridge.errors import BridgeError


def open_at_once(path: Path | str, flags: int) -> int:
    """Return a handle for a file, made if need be; a FIFO in its place is not waited for."""
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)


def read_regular(path: Path | str, limit: int, error: type[BridgeError]) -> bytes:
    """
    Return the bytes of a file, of a regular one only: a FIFO or a device may never end.

    Args:
        path: the file.
        limit: most bytes accepted.
        error: what is raised, with one line that names the file.

    Raises:
        error: the file is not there, is not a regular one, is too long or cannot be read.
    """
    try:
        # without O_NONBLOCK opening a FIFO waits for somebody to write into it
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                raise error(f'{path}: not a regular file')
            if found.st_size > limit:
                raise error(f'{path}: {found.st_size} bytes; accepted: up to {limit}')
            with open(handle, 'rb', closefd=False) as file:
                return file.read(limit)
        finally:
            os.close(handle)
    except FileNotFoundError:
        raise error(f'{path}: no such file') from None
    except OSError as problem:
        raise error(f'{path}: {problem.strerror}') from None
