# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal as they are pressed, without waiting for Enter."""
from __future__ import annotations

from collections.abc import Mapping
import contextlib
import os
import select
import sys
import termios
import tty

MOST_BYTES = 256
LEFT, RIGHT, UP, DOWN = 'left', 'right', 'up', 'down'
# what terminals send, in both of their modes
ARROWS = {b'\x1b[A': UP, b'\x1b[B': DOWN, b'\x1b[C': RIGHT, b'\x1b[D': LEFT,
          b'\x1bOA': UP, b'\x1bOB': DOWN, b'\x1bOC': RIGHT, b'\x1bOD': LEFT}


def keys_in(data: bytes, meanings: Mapping[bytes, str]) -> list[str]:
    """Return what the keys mean that a terminal sent; those without a meaning are passed over."""
    longest = max(map(len, meanings))
    found = []
    while data:
        for length in range(longest, 0, -1):
            if data[:length] in meanings:
                found.append(meanings[data[:length]])
                break
        else:
            length = 1
        data = data[length:]
    return found


class TerminalKeys:
    """The standard input as a keyboard; `close` gives the terminal back as it was."""

    def __init__(self) -> None:
        """Take the terminal, if there is one."""
        self._file: int | None = None
        self._before: list | None = None
        with contextlib.suppress(OSError, ValueError, AttributeError, termios.error):
            file = sys.stdin.fileno()
            # one in the background would be stopped for touching it
            if os.isatty(file) and os.tcgetpgrp(file) == os.getpgrp():
                self._before = termios.tcgetattr(file)
                tty.setcbreak(file)
                self._file = file

    @property
    def there(self) -> bool:
        """Return whether there is a terminal."""
        return self._file is not None

    def read(self) -> bytes:
        """Return what has been typed since; never waits."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return b''
        try:
            data = os.read(self._file, MOST_BYTES)
        except OSError:
            data = b''
        if not data:
            # the terminal has gone
            self.close()
        return data

    def close(self) -> None:
        """Give the terminal back."""
        if self._file is not None and self._before is not None:
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)
        self._file = None
