# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A file or folder that one process at a time has for itself."""
from __future__ import annotations

import fcntl
import os

from msgs_bridge.errors import BridgeError


def lock(handle: int, taken: BridgeError) -> bool:
    """
    Lock an open file or folder until its handle is closed, also by the end of the process.

    Args:
        handle: of the file.
        taken: what is raised when another process has it; the handle is closed then.

    Returns:
        whether it is locked; False on a file system without locks.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise taken from None
    except OSError:
        return False
    return True
