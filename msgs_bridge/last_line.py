# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a process says at its end, to whoever is still there to read it."""
import contextlib
import sys


def say(text: str) -> None:
    """Write a line to stderr; a terminal that was closed or a disk that is full is no error."""
    with contextlib.suppress(OSError):
        sys.stderr.write(f'{text}\n')
        sys.stderr.flush()
