# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Laps that are shown as they are driven and kept at once, so that stopping loses none."""
from __future__ import annotations

from collections.abc import Callable, Generator
import time

from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.progress import LapProgress
from carracing_dqn.evaluation.results import Results
from rich.console import Console

# a writing of thousands of laps takes longer than that, and then a tenth of the time at most
QUICK_SECONDS = 0.1
PAUSE = 9


def keep_laps(
    laps: Generator[Lap], results: Results, console: Console, write: Callable[[], None],
) -> bool:
    """
    Drive what is left of some laps; return whether Ctrl-C or SIGTERM ended it.

    Args:
        laps: yields them as they end; closed at the end.
        results: what is there already; takes the laps and the time that they take.
        console: shows how far they are.
        write: keeps the results; called after each lap unless that takes long, and at the end.
    """
    spent, started = results.seconds, time.monotonic()
    next_at = started
    try:
        with LapProgress(results.ordered, results.wanted, console) as progress:
            for lap in laps:
                results.laps[lap.seed] = lap
                now = time.monotonic()
                results.seconds = spent + now - started
                if now >= next_at:
                    write()
                    took = time.monotonic() - now
                    next_at = 0.0 if took < QUICK_SECONDS else now + (1 + PAUSE) * took
                progress.add(lap)
        # when nothing was left to drive, a file may still have been asked for
        write()
    except BaseException as error:
        # it may have come in the middle of a writing, or before the next one
        write()
        if isinstance(error, KeyboardInterrupt):
            return True
        raise
    finally:
        laps.close()
    return False
