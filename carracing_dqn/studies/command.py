# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing study`: training runs by a YAML file, and the page that compares them."""
from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import shlex

from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.outcome import DONE, Outcome, outcome_of, WINDOW
from carracing_dqn.studies.page import write_page
from carracing_dqn.studies.schedule import Schedule
from carracing_dqn.studies.search import Search
from carracing_dqn.studies.study_file import (
    Arm, find_study, load_study, plan, PlannedRun, Study, study_names,
)
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.machine import cores
from msgs_bridge.terminal import say
from rich.console import Console
from trainer_node.run_folder import RunFolder

OUTPUT = Path('runs') / 'studies'
FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing study`."""
    parser.add_argument('study', metavar='FILE|NAME',
                        help=f'a YAML file, or one of {", ".join(study_names())}')
    parser.add_argument('--output', type=Path, default=None, metavar='DIR',
                        help='where the runs are; what is there already is gone on with '
                             f'(default: {OUTPUT}/NAME)')
    parser.add_argument('--page', type=Path, default=None, metavar='DIR',
                        help='where the page is written, docs/studies for one (default: that '
                             'of the runs)')
    parser.add_argument('--processes', type=int, default=cores(), metavar='N',
                        help='runs at a time (default: %(default)s, the cores)')
    parser.add_argument('--only', action='append', default=[], metavar='ARM',
                        help='drive this arm alone; may be given several times')
    parser.add_argument('--no-runs', action='store_true',
                        help='drive nothing; write the page of what is there')


def main(arguments: argparse.Namespace) -> int:
    """Drive what is left of a study and write its page; 1 when a run failed, 130 if stopped."""
    study = load_study(find_study(arguments.study))
    if arguments.processes < 1:
        raise StudyError(f'--processes is {arguments.processes}; accepted: 1 or more')
    unknown = [name for name in arguments.only if name not in [arm.name for arm in study.arms]]
    if unknown:
        raise StudyError(f'--only {unknown[0]}: there is no such arm; there are '
                         f'{", ".join(arm.name for arm in study.arms)}')
    output = arguments.output or OUTPUT / study.name
    return _Session(study, output, arguments).drive()


class _Session:
    """One call of the command."""

    def __init__(self, study: Study, output: Path, arguments: argparse.Namespace) -> None:
        self._study, self._output, self._arguments = study, output, arguments
        self._console = Console()
        self._search = Search(study, output) if study.search else None
        self._arms: list[Arm] = [*study.arms, *(self._search.arms if self._search else ())]
        self._runs: list[PlannedRun] = plan(study, tuple(self._arms), output)
        # of this call: why runs could not be begun at all is in no folder
        self._problems: dict[Path, str] = {}

    def _say(self, text: str) -> None:
        say(self._console, text)

    def drive(self) -> int:
        """Drive, write the page, and return the exit code."""
        for note in self._study.notes:
            self._say(note)
        interrupted = not self._arguments.no_runs and self._drive_runs()
        outcomes = [self._outcome(run) for run in self._runs]
        page = write_page(
            self._study, self._arms, outcomes, self._arguments.page or self._output)
        self._say(f'wrote {page}')
        if interrupted:
            output = self._arguments.output
            self._say(f'stopped; go on with: carracing study {shlex.quote(self._arguments.study)}'
                      + (f' --output={shlex.quote(str(output))}' if output else ''))
            return INTERRUPTED
        return FAILED if any(outcome.problem for outcome in outcomes) else 0

    def _outcome(self, run: PlannedRun) -> Outcome:
        return outcome_of(run, self._study.settings, self._problems.get(run.folder, ''))

    def _drive_runs(self) -> bool:
        """Drive what is left; return whether it was stopped."""
        try:
            self._output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StudyError(f'{self._output}: {error.strerror}') from None
        lock = RunFolder(self._output)
        lock.lock()
        try:
            with Schedule(
                self._study.settings, self._arguments.processes, self._say, self._tell_progress,
            ) as schedule:
                for run, problem in schedule.drive(self._left()):
                    self._ended(run, problem)
        except KeyboardInterrupt:
            return True
        finally:
            lock.unlock()
        return False

    def _left(self) -> Iterator[PlannedRun]:
        """Yield the runs that are still to be driven."""
        only = self._arguments.only
        yield from self._undone([run for run in self._runs if not only or run.arm in only])
        while self._search and not self._search.complete and not only:
            arm = self._search.draw(self._scores())
            if arm is None:
                break
            runs = plan(self._study, (arm,), self._output)
            self._arms.append(arm)
            self._runs += runs
            yield from self._undone(runs)

    def _undone(self, runs: list[PlannedRun]) -> Iterator[PlannedRun]:
        for run in runs:
            if self._outcome(run).state == DONE:
                self._say(f'{run.name}: done before')
            else:
                yield run

    def _scores(self) -> dict[str, float]:
        """Return the mean of the runs of each arm that are done, by its name."""
        found: dict[str, list[float]] = {}
        for run in self._runs:
            outcome = self._outcome(run)
            if outcome.state == DONE:
                found.setdefault(run.arm, []).append(float(outcome.scores.mean()))
        return {arm: sum(scores) / len(scores) for arm, scores in found.items()}

    def _ended(self, run: PlannedRun, problem: str) -> None:
        if problem:
            self._problems[run.folder] = problem
            self._say(f'{run.name}: FAILED: {problem}')
            return
        scores = self._outcome(run).scores
        self._say(f'{run.name}: done, {scores.mean():.1f} points')

    def _tell_progress(self, runs: list[PlannedRun]) -> None:
        for run in runs:
            outcome = self._outcome(run)
            last = outcome.curve.returns[-1:]
            settings, figures = run.settings, outcome.figures
            share = max(
                figures.get(name, 0) / limit if limit else 0.0 for name, limit in (
                    ('decisions', settings.run_decisions), ('episodes', settings.run_episodes)))
            self._say(f'{run.name}: {100 * share:.0f} %, {figures.get("episodes", 0):.0f} episodes'
                      + ''.join(f', the last {WINDOW} made {value:.1f}' for value in last))
