# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C before a program has begun: it ends at once and says nothing."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
import signal


@contextlib.contextmanager
def ends_when_interrupted(code: int = 0) -> Iterator[None]:
    """
    End the process with a code at a SIGINT in the `with` block, which does nothing but import.

    A KeyboardInterrupt would not do: raised while a compiled module is loading it comes out as
    any other error. Whoever ignores SIGINT, as in the background of a shell, goes on doing so.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: os._exit(code))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
