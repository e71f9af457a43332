# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A process at a terminal of its own, as a person would have it."""
import contextlib
import fcntl
import os
import pty
import re
import struct
import subprocess
import termios

from graph_probe import wait_for

WIDTH = 80


class Terminal:
    """A process at a terminal of 80x24 of its own, and what it has shown there."""

    def __init__(self, command):
        self.ours, self._theirs = pty.openpty()
        fcntl.ioctl(self._theirs, termios.TIOCSWINSZ, struct.pack('HHHH', 24, WIDTH, 0, 0))
        self.before = termios.tcgetattr(self._theirs)
        self.process = subprocess.Popen(
            command, stdin=self._theirs, stdout=self._theirs, stderr=self._theirs,
            start_new_session=True, env={**os.environ, 'PYTHONUTF8': '1', 'TERM': 'xterm'},
            preexec_fn=lambda: fcntl.ioctl(self._theirs, termios.TIOCSCTTY, 0))
        os.set_blocking(self.ours, False)
        self.shown = ''

    def shows(self, pattern):
        """Return whether a line has shown what matches since the last time it was asked."""
        with contextlib.suppress(BlockingIOError):
            self.shown += os.read(self.ours, 65536).decode('utf-8', 'replace')
        found = list(re.finditer(pattern, self.shown))
        if found:
            self.shown = self.shown[found[-1].end():]
        return found[-1] if found else None

    def until(self, pattern, seconds=30):
        found = []
        wait_for(lambda: found.append(self.shows(pattern)) or found[-1], seconds, pattern)
        return found[-1]

    def type(self, keys):
        os.write(self.ours, keys)

    @property
    def given_back(self):
        return termios.tcgetattr(self._theirs)[3] == self.before[3]

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.ours)
        os.close(self._theirs)
