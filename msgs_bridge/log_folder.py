# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A place for the logs of rcl, which starts nothing without one."""
from __future__ import annotations

import os
from pathlib import Path

from msgs_bridge.errors import BridgeError
from msgs_bridge.private_folder import make_temporary

VARIABLE = 'ROS_LOG_DIR'


def ensure_log_folder() -> None:
    """
    Set `ROS_LOG_DIR` to a temporary folder where the user has named none and has no home.

    Raises:
        BridgeError: no folder can be written.
    """
    named = os.environ.get(VARIABLE)
    home = os.environ.get('ROS_HOME')
    try:
        folder = Path(named) if named else (Path(home) if home else Path.home() / '.ros') / 'log'
        _make(folder)
        if not (named or home or os.environ.get('HOME')):
            # rcl knows a home by this variable alone, Python by the list of users as well
            os.environ[VARIABLE] = str(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home
        if named or home:
            raise _no_place(error) from None
        try:
            folder = make_temporary('ros_log')
        except OSError as error:
            raise _no_place(error) from None
        os.environ[VARIABLE] = str(folder)


def _make(folder: Path) -> None:
    folder = Path(os.path.expanduser(folder))
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f'{folder} is not writable')


def _no_place(error: Exception) -> BridgeError:
    return BridgeError(f'ROS has no place for its logs, set {VARIABLE} to one: {error}')
