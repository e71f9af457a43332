# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from recorded transitions: the same trainer, without a graph."""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
import dataclasses
import itertools
from pathlib import Path
import time
from typing import Any

from bags.topic_lookup import need_topic
from bags.reader import BagReader
from bags.transitions import bag_transitions
from carracing_dqn.bringup.training_display import model_lines
from carracing_dqn.evaluation.statistics import percent
from carracing_dqn.evaluation.validator import validate_weights
from carracing_dqn.simulation.profiles import found_from
from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.topics import IMAGE, STEP
from msgs_bridge.transitions import Transition
from rich.console import Console
from trainer_node.demonstrations import as_decisions
from trainer_node.driver import Driver
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.open_run import open_training, run_settings
from trainer_node.run_folder import RunFolder
from trainer_node.training import SOURCE, Training

LINE_SECONDS = 5.0
# share of a run from which on its pace tells when it ends
SOON = 0.02


def learn_from_bags(
    bags: list[Path], folder: Path, preset: str, overrides: dict[str, Any], console: Console, *,
    namespace: str, resume: bool, tensorboard: bool,
) -> int:
    """
    Feed the transitions of bags to a trainer as fast as it takes them; return the exit code.

    The run ends with the bags; what a preset says in minutes goes by the share of them. Frames
    that are nearer to each other than decisions are joined into such. Checkpoints are written as
    in the graph, validations are driven in this process, and whatever happens, what was learned is
    saved. A run that is resumed with the same bags goes on where it was; with others it is as much
    longer as they are, if its length came from bags.

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
    settings = run_settings(folder, preset, overrides, resume=resume)
    seconds = settings.model_description().stack_seconds
    bags_read = [_look_at(bag, namespace, seconds) for bag in bags]
    steps = sum(bag.decisions for bag in bags_read)
    names = [bag.name for bag in bags_read]
    given = settings.run_decisions
    if resume:
        settings = _longer(settings, RunFolder(folder), names, steps, overrides)
    elif 'run_minutes' not in overrides:
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
    taken = training.learns_from(
        names, settings.run_decisions if settings.run_decisions != given else None)
    counts: Counter[str] = Counter()
    try:
        transitions = as_decisions(bag_transitions(bags, namespace=namespace), seconds, counts)
        _learn(driver, itertools.islice(transitions, taken, None), say)
    finally:
        say(status_line(training))
        if counts['uneven']:
            say(f'{counts["uneven"]} decisions were passed over: a late frame made them longer or '
                f'shorter than {seconds:g} s')
        if not training.failed:
            say(f'saved {driver.close()}')
            for line in model_lines(folder):
                say(line)
    return 0


def _learn(driver: Driver, transitions: Iterable[Transition], say: Any) -> None:
    """Learn from all transitions, or until the run is complete."""
    next_line = 0.0
    while driver.pretraining and driver.turn():
        pass
    for transition in transitions:
        # a run that is complete takes none
        if not driver.turn() or driver.ended:
            break
        driver.add(transition)
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + LINE_SECONDS
            say(status_line(driver.training))
    driver.end()
    while driver.turn():
        pass


@dataclasses.dataclass(frozen=True)
class _Recorded:
    """
    What is known of a bag before it is learned from.

    Attributes:
        name: its own, and what tells it from another of that name.
        decisions: a transition for each, or one less an episode.
    """

    name: str
    decisions: int


def _look_at(bag: Path, namespace: str, seconds: float) -> _Recorded:
    """
    Return what a bag is to a run whose decisions last some seconds.

    Raises:
        BagError: it cannot be read, or lacks images or steps.
        LearningError: its frames make no such decisions.
    """
    with BagReader(bag) as reader:
        need_topic(reader, IMAGE, namespace=namespace)
        steps = reader.topics[need_topic(reader, STEP, namespace=namespace)].message_count
        name = f'{bag.resolve().name}, {steps} steps from {reader.start_time} ns'
    transitions = bag_transitions([bag], namespace=namespace)
    first = next(transitions, None)
    if first is None:
        return _Recorded(name, 0)
    # a bag of another rate is better refused before the run than in the middle of it
    next(as_decisions(itertools.chain([first], transitions), seconds), None)
    frames = round(seconds * NANOSECONDS / (first.next_stamp - first.stamp))
    return _Recorded(name, steps // max(frames, 1))


def _longer(
    settings: Hyperparameters, folder: RunFolder, names: list[str], decisions: int,
    overrides: dict[str, Any],
) -> Hyperparameters:
    """Return settings with room for other bags, where those before have set the length."""
    before = folder.read_record().get(SOURCE)
    if (isinstance(before, dict) and before.get('names') != names
            and before.get('run_decisions') == settings.run_decisions
            and 'run_decisions' not in overrides):
        return dataclasses.replace(
            settings, run_decisions=settings.run_decisions + decisions)
    return settings


def status_line(training: Training) -> str:
    """Return how far learning is as one line."""
    status = training.status()
    foreign = status['foreign_actions']
    # most of what a person or another model drives is none of a few actions
    hint = '; --demonstrations takes the nearest' if foreign > status['decisions'] else ''
    progress = training.progress
    left = (f', about {training.wall_seconds / 60 * (1 / progress - 1):.1f} min left'
            if SOON < progress < 1 else '')
    return (f'{percent(progress)} done{left}, {status["decisions"]} transitions, '
            f'{status["updates"]} updates, {foreign} actions that are not in the set{hint}')
