# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One run of a study: learn, then drive test laps; in a process of its own.

    python -m carracing_dqn.studies.one_run RUN --laps 30 --test-seed 200000 --model final

RUN holds `plan.yaml`, all hyperparameters of the run. What is there already is gone on with.
"""
from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path
import signal
import sys
import time

from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.policies import model_source
from carracing_dqn.evaluation.results import resume, write_json
from carracing_dqn.evaluation.sources import simulator_source
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation.profiles import found_from
from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.one_process import learn
from carracing_dqn.studies.study_file import BEST, FINAL
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR, INTERRUPTED
from msgs_bridge.last_line import say
from msgs_bridge.machine import describe_machine
from msgs_bridge.plain_text import plain
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.open_run import open_training, run_settings
from trainer_node.run_folder import RunFolder

PLAN = 'plan.yaml'
LAPS = 'evaluation.json'
# laps between two writings of their file
LAPS_KEPT = 5


class Stop:
    """Whether the run is to be left: by a signal, or because who started it is gone."""

    def __init__(self, parent: int) -> None:
        """Listen to SIGINT and SIGTERM from here on; end with a parent process."""
        self._parent = parent
        self._told = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._tell)

    def _tell(self, *_: object) -> None:
        self._told = True

    def __call__(self) -> bool:
        """Return whether to stop now."""
        return self._told or os.getppid() != self._parent


def train(folder: Path, stop: Stop) -> None:
    """
    Learn until the run is complete or stopped.

    Raises:
        BridgeError: it cannot begin, go on or be written.
    """
    run = RunFolder(folder)
    planned = run_settings(folder, str(folder / PLAN), {}, resume=False)
    begun = run.config.is_file()
    if begun:
        # a processor without bfloat16 may have begun it
        own = load_preset(run.config)
        planned = dataclasses.replace(planned, bf16=own.bf16)
        if own != planned:
            raise StudyError(f'{folder} holds a run with other settings than {PLAN}')
    if learned(run):
        return
    learn(open_training(folder, planned, resume=begun, device='cpu'), should_stop=stop)


def learned(run: RunFolder) -> bool:
    """Return whether a run has its last model and its record says that it is complete."""
    return run.read_record().get('complete') is True and run.final.is_dir()


def tested(run: RunFolder, model: str) -> Path:
    """Return the folder of the model of a run that is tested, FINAL or BEST."""
    return run.best if model == BEST and run.best.is_dir() else run.final


def drive_tests(
    folder: Path, settings: Hyperparameters, seeds: range, model: str, stop: Stop,
) -> None:
    """
    Drive test laps with a model of the run; those that are kept already are not driven again.

    Raises:
        BridgeError: the model or the file cannot be used.
    """
    run = RunFolder(folder)
    source = model_source(str(tested(run, model)))
    simulator = found_from(settings.simulator, folder)
    results = resume(folder / LAPS, source.identity(), settings.simulator, seeds,
                     simulator_source(simulator))
    results.wanted, results.machine = len(seeds), describe_machine()
    todo = [seed for seed in seeds if seed not in results.laps]
    spent, started = results.seconds, time.monotonic()
    laps = drive_laps(source, todo, simulator=simulator)
    for number, lap in enumerate(laps, 1):
        results.laps[lap.seed] = lap
        if number % LAPS_KEPT == 0 or number == len(todo) or stop():
            results.seconds = spent + time.monotonic() - started
            write_json(folder / LAPS, results)
        if stop():
            break


def main(argv: list[str] | None = None) -> int:
    """Do the run; return 0 when it is whole, 130 when it was stopped, 2 with a line of why."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('run', type=Path, help='its folder')
    parser.add_argument('--laps', type=int, default=0, help='test laps')
    parser.add_argument('--test-seed', type=int, default=0, help='of the first one')
    parser.add_argument('--model', choices=(FINAL, BEST), default=FINAL, help='which to test')
    parser.add_argument('--parent', type=int, default=os.getppid(), help='process to end with')
    arguments = parser.parse_args(argv)
    # it may have gone while this one was still importing
    stop = Stop(arguments.parent)
    limit_torch_threads()
    try:
        train(arguments.run, stop)
        if not stop() and arguments.laps:
            drive_tests(
                arguments.run, load_preset(arguments.run / PLAN),
                range(arguments.test_seed, arguments.test_seed + arguments.laps),
                arguments.model, stop)
    except (BridgeError, OSError, MemoryError) as error:
        say(f'error: {plain(error, 1000) or type(error).__name__}')
        return ERROR
    return INTERRUPTED if stop() else 0


if __name__ == '__main__':
    sys.exit(main())
