# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from recorded transitions: the same trainer, without a graph."""
from __future__ import annotations

from pathlib import Path
import time

from bags.transitions import bag_transitions
from msgs_bridge.errors import MessageError
from rich.console import Console
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.training import Training

LINE_SECONDS = 5.0


def learn_from_bags(
    hyperparameters: Hyperparameters, folder: Path, bags: list[Path], console: Console, *,
    resume: bool, tensorboard: bool,
) -> int:
    """
    Feed the transitions of bags to a trainer as fast as it takes them; return the exit code.

    Whatever happens, what was learned is saved.
    """
    open_run = Training.resume if resume else Training.create
    arguments = (folder, hyperparameters) if resume else (hyperparameters, folder)
    training = open_run(*arguments, tensorboard=tensorboard)
    next_line = 0.0
    complete = False
    try:
        for transition in bag_transitions(bags):
            try:
                training.add(transition)
            except MessageError:
                continue  # an action of another set; counted by the trainer
            if time.monotonic() >= next_line:
                next_line = time.monotonic() + LINE_SECONDS
                console.print(status_line(training), highlight=False)
            if training.complete:
                break
        complete = True
    finally:
        console.print(status_line(training), highlight=False)
        saved = training.finish() if complete else training.save()
        console.print(f'saved {saved}', highlight=False, soft_wrap=True)
    return 0


def status_line(training: Training) -> str:
    """Return how far learning is as one line."""
    status = training.status()
    return (f'{status["decisions"]} transitions, {status["updates"]} updates, '
            f'{status["foreign_actions"]} actions that are not in the set')
