# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from recorded transitions: the same trainer, without a graph."""
from __future__ import annotations

from collections.abc import Iterable
import itertools
from pathlib import Path
import time
from typing import Any

from bags.topic_lookup import need_topic
from bags.reader import BagReader
from bags.transitions import bag_transitions
from carracing_dqn.bringup.training_display import model_lines
from carracing_dqn.evaluation.validator import validate_weights
from carracing_dqn.simulation.profiles import found_from
from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.topics import IMAGE, STEP
from rich.console import Console
from trainer_node.driver import Driver
from trainer_node.open_run import open_training, run_settings
from trainer_node.training import Training

LINE_SECONDS = 5.0
# share of a run from which on its pace tells when it ends
SOON = 0.02


def learn_from_bags(
    bags: list[Path], folder: Path, preset: str, overrides: dict[str, Any], console: Console, *,
    namespace: str, resume: bool, tensorboard: bool,
) -> int:
    """
    Feed the transitions of bags to a trainer as fast as it takes them; return the exit code.

    The run ends with the bags; what a preset says in minutes goes by the share of them.
    Checkpoints are written as in the graph, validations are driven in this process, and whatever
    happens, what was learned is saved. A run that is resumed with the same bags goes on where it
    was.

    Args:
        bags: what is learned from, in order.
        folder: of the run.
        preset: its hyperparameters; those of the run when it is resumed.
        overrides: hyperparameters that differ from them.
        console: where progress is shown.
        namespace: where the topics of the car are; needed if there are several.
        resume: whether to go on with the run in the folder.
        tensorboard: whether to write event files, too.

    Raises:
        BridgeError: a bag, a setting or the folder cannot be used; nothing is left behind then.
    """
    steps = count_steps(bags, namespace)
    settings = run_settings(folder, preset, overrides, resume=resume)
    if 'run_minutes' not in overrides:
        settings = settings.for_recorded(steps)
    if steps <= settings.learning_starts and not resume:
        raise SettingsError(
            f'the bags hold at most {steps - 1} transitions, so nothing is learned with '
            f'learning_starts {settings.learning_starts}; set it lower')
    simulator = found_from(settings.simulator, folder)
    training = open_training(folder, settings, resume=resume, tensorboard=tensorboard)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    def publish(data: bytes) -> dict[str, float] | None:
        try:
            return validate_weights(data, settings.validation_seeds, simulator)
        except BridgeError as error:
            say(f'no validation: {error}')
            return None

    driver = Driver(training, publish, say=say, last_validation_seconds=settings.validates)
    taken = training.learns_from([bag.name for bag in bags])
    try:
        transitions = bag_transitions(bags, namespace=namespace)
        _learn(driver, itertools.islice(transitions, taken, None), say)
    finally:
        say(status_line(training))
        if not training.failed:
            say(f'saved {driver.close()}')
            for line in model_lines(folder):
                say(line)
    return 0


def _learn(driver: Driver, transitions: Iterable[Any], say: Any) -> None:
    """Learn from all transitions, or until the run is complete."""
    next_line = 0.0
    while driver.pretraining and driver.turn():
        pass
    for transition in transitions:
        driver.add(transition)
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + LINE_SECONDS
            say(status_line(driver.training))
        if not driver.turn() or driver.ended:
            break
    driver.end()
    while driver.turn():
        pass


def count_steps(bags: Iterable[Path], namespace: str) -> int:
    """
    Return how many `step` messages bags hold: a transition for each, or one less an episode.

    Raises:
        BagError: a bag cannot be read, or lacks images or steps.
    """
    count = 0
    for bag in bags:
        with BagReader(bag) as reader:
            need_topic(reader, IMAGE, namespace=namespace)
            count += reader.topics[
                need_topic(reader, STEP, namespace=namespace)].message_count
    return count


def status_line(training: Training) -> str:
    """Return how far learning is as one line."""
    status = training.status()
    foreign = status['foreign_actions']
    # most of what a person or another model drives is none of a few actions
    hint = '; --demonstrations takes the nearest' if foreign > status['decisions'] else ''
    progress = training.progress
    left = (f', about {training.wall_seconds / 60 * (1 / progress - 1):.1f} min left'
            if SOON < progress < 1 else '')
    return (f'{progress:.0%} done{left}, {status["decisions"]} transitions, '
            f'{status["updates"]} updates, {foreign} actions that are not in the set{hint}')
