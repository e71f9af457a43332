# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from recorded transitions: the same trainer, without a graph."""
from __future__ import annotations

from pathlib import Path
import time

from bags.transitions import bag_transitions
from rich.console import Console
from trainer_node.training import Training

LINE_SECONDS = 5.0


def learn_from_bags(training: Training, bags: list[Path], console: Console) -> int:
    """
    Feed the transitions of bags to a trainer as fast as it takes them; return the exit code.

    Whatever happens, what was learned is saved.
    """
    next_line = 0.0
    try:
        for transition in bag_transitions(bags):
            training.add(transition)
            if time.monotonic() >= next_line:
                next_line = time.monotonic() + LINE_SECONDS
                status = training.status()
                console.print(f'{status["decisions"]:.0f} transitions, '
                              f'{status["updates"]:.0f} updates', highlight=False)
            if training.finished:
                break
        training.finish()
    finally:
        console.print(f'saved {training.save()}', highlight=False, soft_wrap=True)
        training.close()
    return 0
