# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The runs of a study, so many at a time, each in a process of one thread.

Nothing that a run learns depends on a clock, so runs that are driven beside each other learn the
same as alone; they only take longer.
"""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import contextlib
import dataclasses
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from carracing_dqn.evaluation.workers import THREAD_VARIABLES
from carracing_dqn.studies.one_run import PLAN
from carracing_dqn.studies.study_file import PlannedRun, StudySettings
from msgs_bridge.atomic_write import write_text
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import open_at_once
from trainer_node.hyperparameters import load_preset, to_yaml

LOG = 'log.txt'
FAILURE = 'failure.txt'
LOOK_SECONDS = 0.2
WATCH_SECONDS = 60.0
# a validation is driven to its end before a run looks whether to stop
STOP_SECONDS = 300.0
MAX_REASON = 400


@dataclasses.dataclass
class _Running:
    run: PlannedRun
    process: subprocess.Popen[bytes]


class Schedule:
    """Starts runs and takes note of how they end; a `with` block leaves none behind."""

    def __init__(
        self, settings: StudySettings, processes: int, say: Callable[[str], None],
        watch: Callable[[list[PlannedRun]], None],
    ) -> None:
        """
        Prepare for so many runs at a time.

        Args:
            settings: of the study.
            processes: runs at a time.
            say: takes a line about what has happened.
            watch: takes the runs that are under way every now and then.
        """
        self._settings = settings
        self._processes = processes
        self._say = say
        self._watch = watch
        self._running: list[_Running] = []

    def __enter__(self) -> Schedule:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def drive(self, runs: Iterable[PlannedRun]) -> Iterator[tuple[PlannedRun, str]]:
        """
        Yield each run when it has ended, with why it failed, '' if it did not.

        Args:
            runs: those that are still to be done; the next one is asked for when there is room.
        """
        source = iter(runs)
        more, watched = True, time.monotonic()
        while more or self._running:
            while more and len(self._running) < self._processes:
                run = next(source, self)
                if run is self:
                    more = False
                elif run.problem:
                    yield run, run.problem
                elif problem := self._start(run):
                    yield run, problem
            yield from self._ended()
            if self._running:
                time.sleep(LOOK_SECONDS)
            if time.monotonic() - watched > WATCH_SECONDS:
                watched = time.monotonic()
                self._watch([running.run for running in self._running])

    def _start(self, run: PlannedRun) -> str:
        """Start the process of a run; return why that cannot be, '' if it can."""
        settings = self._settings
        try:
            if (run.folder / PLAN).is_file() and load_preset(run.folder / PLAN) != run.settings:
                return (f'{run.folder} holds a run with other settings than the study asks for; '
                        'delete it, or name another folder by --output')
            run.folder.mkdir(parents=True, exist_ok=True)
            (run.folder / FAILURE).unlink(missing_ok=True)
            write_text(run.folder / PLAN, to_yaml(run.settings))
            with open(run.folder / LOG, 'ab', opener=open_at_once) as log:
                process = subprocess.Popen(
                    [sys.executable, '-m', 'carracing_dqn.studies.one_run',
                     '--laps', str(settings.laps), '--test-seed', str(settings.test_seed),
                     '--model', settings.model, '--parent', str(os.getpid()),
                     # its name may begin with a dash
                     '--', str(run.folder)],
                    stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                    # Ctrl-C in a terminal is for the command, which passes it on once
                    start_new_session=True,
                    env={**os.environ, **dict.fromkeys(THREAD_VARIABLES, '1')})
        except OSError as error:
            return f'{error.filename or run.folder}: {error.strerror}'
        except BridgeError as error:
            return plain(error, MAX_REASON)
        self._running.append(_Running(run, process))
        self._say(f'{run.name}: begun')
        return ''

    def _ended(self) -> Iterator[tuple[PlannedRun, str]]:
        for running in list(self._running):
            code = running.process.poll()
            if code is None:
                continue
            self._running.remove(running)
            problem = '' if code == 0 else why_ended(running.run.folder, code)
            if problem:
                with contextlib.suppress(OSError):
                    write_text(running.run.folder / FAILURE, problem + '\n')
            yield running.run, problem

    def stop(self) -> None:
        """Let every run write its checkpoint and end."""
        for running in self._running:
            running.process.send_signal(signal.SIGTERM)
        until = time.monotonic() + STOP_SECONDS
        try:
            for running in self._running:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    running.process.wait(max(until - time.monotonic(), 0.0))
        finally:
            # a second Ctrl-C comes here: the checkpoint of a minute ago has to do
            for running in self._running:
                if running.process.poll() is None:
                    running.process.kill()
                    running.process.wait()
            self._running.clear()


def why_ended(folder: Path, code: int) -> str:
    """Return why a run has ended that was not to."""
    if code == INTERRUPTED:
        return 'stopped by a signal'
    if code < 0:
        return f'its process was ended by signal {-code}'
    with contextlib.suppress(OSError):
        with open(folder / LOG, 'rb', opener=open_at_once) as log:
            log.seek(max(log.seek(0, os.SEEK_END) - 8 * MAX_REASON, 0))
            lines = log.read().decode('utf-8', 'replace').split('\n')
        said = [line.strip() for line in lines if line.strip()]
        if said:
            return plain(said[-1].removeprefix('error: '), MAX_REASON)
    return f'its process ended with code {code}'
