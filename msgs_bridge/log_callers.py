# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Log messages name a source file by its package, not by the folder that it lies in."""
from __future__ import annotations

import functools
from pathlib import Path
import sys
from typing import Any

from rclpy.impl import rcutils_logger

# what rclpy knows of who has logged something
FIELDS = ('function_name', 'file_path', 'line_number', 'last_index')
_known = getattr(rcutils_logger, 'CallerId', None)
_find_caller = getattr(rcutils_logger, '_find_caller', None)


def hide_folders() -> None:
    """
    Let `/rosout` say `bags/recorder_node.py` and not whose home that lies in.

    What is logged is recorded, and bags are shared. rclpy has no setting for it; where it is
    another than we know, its log messages stay as they are.
    """
    if getattr(_known, '_fields', ()) == FIELDS and _find_caller is not None:
        rcutils_logger.CallerId = _caller


def _caller(frame: Any = None) -> Any:
    # the frame of rclpy's own logger, from which it looks for who has called it
    frame = frame or _find_caller(sys._getframe(1))
    return _known._make((
        frame.f_code.co_name, _source(frame.f_code.co_filename), frame.f_lineno, frame.f_lasti))


@functools.cache
def _source(path: str) -> str:
    """Return the path of a source file below the folder of its package."""
    top = Path(path).parent
    while (top / '__init__.py').is_file():
        top = top.parent
    return str(Path(path).relative_to(top))
