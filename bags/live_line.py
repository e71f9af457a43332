# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A line at the bottom of a terminal that is written anew as things go on."""
from __future__ import annotations

import contextlib
import os
import sys

from msgs_bridge.plain_text import plain

ERASE = '\x1b[K'


class LiveLine:
    """Shows a text on stderr if that is a terminal; a log line takes its place."""

    def __init__(self) -> None:
        """Show nothing yet."""
        self._shown = False
        self.there = sys.stderr.isatty()

    def show(self, text: str) -> None:
        """Show a text in place of the last one, cut to the width of the terminal."""
        if not self.there:
            return
        with contextlib.suppress(OSError):
            file = sys.stderr.fileno()
            # one in the background would write over what a person types
            if os.tcgetpgrp(file) != os.getpgrp():
                return
            width = os.get_terminal_size(file).columns
            # the cursor stands at the start of the line, where the next log line begins
            sys.stderr.write(f'\r{plain(text, max(width - 1, 1))}{ERASE}\r')
            sys.stderr.flush()
            self._shown = True

    def close(self) -> None:
        """Leave an empty line."""
        if self._shown:
            self._shown = False
            with contextlib.suppress(OSError):
                sys.stderr.write(f'\r{ERASE}')
                sys.stderr.flush()


def clock_text(seconds: float) -> str:
    """Return a time as hours, where there are any, minutes and tenths of a second."""
    tenths = round(max(seconds, 0.0) * 10)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    return (f'{hours}:{minutes:02d}' if hours else f'{minutes}') + f':{rest / 10:04.1f}'
