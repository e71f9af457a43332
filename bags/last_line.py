# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a node says at its end, to whoever is still there to read it."""
import contextlib
import sys


def say(text: str) -> None:
    """Write a line to stderr; a terminal that was closed meanwhile is no error."""
    with contextlib.suppress(OSError):
        sys.stderr.write(f'{text}\n')
        sys.stderr.flush()
