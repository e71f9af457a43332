# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing report`: the figures and tables of the seed document from a run's records."""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.comparison import compare, judge
from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.figure_style import save_figure
from carracing_dqn.evaluation.kept_laps import keep_laps
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.policies import MODEL, PolicySource
from carracing_dqn.evaluation.records import add_results, load_run, Run
from carracing_dqn.evaluation.report_page import lap_pictures, make_pictures, markdown, render
from carracing_dqn.evaluation.results import locked, Results, resume, RUNS, write_json
from carracing_dqn.evaluation.sources import simulator_source
from carracing_dqn.evaluation.trajectory import drive_trajectory, Trajectory
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import make_simulator
from dqn_policy_node.model_record import MODEL_FILE
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge.atomic_write import write_bytes, write_text
from msgs_bridge.errors import BridgeError
from msgs_bridge.machine import cores, describe_machine
from msgs_bridge.terminal import say
from msgs_bridge.share import share_path
from rich.console import Console

SEED = 'seed'
DUMMY_LAPS = 100
# in simulators that may be slow
FEWER_LAPS = 20
DUMMY_SEED = 100_000
# each is driven again, and its picture stands in the page
MOST_LAPS = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument('run', metavar='RUN', help='run folder, or folder or name of a model with '
                        'the record of its training')
    parser.add_argument(
        '--against', action='append', default=[], metavar='RUN|seed',
        help='lay another run over it, any number of times; seed: only the seed document, which '
        'is always there')
    parser.add_argument('--output', type=Path, metavar='DIR',
                        help='folder to write to (default: RUN/report, of a model '
                        f'{RUNS}/report-NAME)')
    parser.add_argument(
        '--evaluation', type=Path, metavar='FILE',
        help='test laps of the model, written by carracing evaluate --json (default: '
        'evaluation*.json in RUN)')
    parser.add_argument(
        '--dummy', type=Path, metavar='FILE',
        help='laps of the dummy agent, written by carracing evaluate --policy random --json '
        f'(default: dummy*.json in RUN, or {DUMMY_LAPS} laps driven now)')
    parser.add_argument(
        '--laps', type=int, default=3, metavar='N',
        help='laps to show from above: the best, the worst and the median of the test, then '
        'others; 0 for none (default: %(default)s)')


def main(arguments: argparse.Namespace) -> int:
    """
    Write the report; return the exit code.

    Raises:
        BridgeError: a run or file that cannot be used; what is only incomplete is shown.
    """
    if not 0 <= arguments.laps <= MOST_LAPS:
        raise EvaluationError(f'--laps is {arguments.laps}; accepted: 0 to {MOST_LAPS}')
    console = Console()
    runs = [load_run(_find(arguments.run))]
    runs += [load_run(_find(other)) for other in arguments.against if other != SEED]
    for path, dummy in ((arguments.evaluation, False), (arguments.dummy, True)):
        if path is not None:
            add_results(runs[0], path, dummy=dummy)
    for run in runs:
        if run.evaluation is None:
            run.problems.append(
                'There are no test laps; carracing evaluate --model RUN drives them.')
    for run in runs[1:]:
        if run.simulator != runs[0].simulator and not (
                run.in_carracing and runs[0].in_carracing):
            raise EvaluationError(f'{run.name} learned in {run.simulator}, {runs[0].name} in '
                                  f'{runs[0].simulator}: they cannot be laid over each other')
    _distinct_names(runs)
    output = arguments.output or _place(_find(arguments.run))
    _make_folder(output / 'figures')
    _need_dummy(runs, output, console)
    laps = lap_pictures(list(_trajectories(runs[0], arguments.laps, console)))
    pictures = make_pictures(runs)
    try:
        for picture in (*pictures, *laps):
            if picture.figure is not None:
                save_figure(picture.figure, output / 'figures', picture.name)
        verdicts = [judge(run) for run in runs]
        _write(output / 'tables.md', markdown(runs, verdicts))
        write_text(output / 'tables.json', json.dumps(_as_json(runs), indent=1) + '\n')
        _write(output / 'report.html', render(runs, pictures, laps))
    except OSError as error:
        raise EvaluationError(f'{output} cannot be written: {error.strerror}') from None
    for run, judged in zip(runs, verdicts):
        for problem in run.problems:
            say(console, f'{run.name}: {problem}')
        for verdict in judged:
            say(console,
                f'{run.name}: {verdict.word}: {verdict.objective.text} ({verdict.text})')
    say(console, f'wrote {output / "report.html"}')
    return 0


def _write(path: Path, text: str) -> None:
    """Write a page; records may hold halves of signs, which no file can."""
    write_bytes(path, text.encode('utf-8', 'replace'))


def _find(text: str) -> Path:
    """Return a run folder, or the folder of a shipped model of that name."""
    if not Path(os.path.expanduser(text)).is_dir():
        with contextlib.suppress(FileNotFoundError):
            return share_path(Path('models') / text)
    return Path(os.path.expanduser(text))


def _place(folder: Path) -> Path:
    """Return where the report of a run goes; nothing is added to the folder of a model."""
    if (folder / MODEL_FILE).is_file():
        return RUNS / f'report-{folder.resolve().name}'
    return folder / 'report'


def _need_dummy(runs: list[Run], output: Path, console: Console) -> None:
    """Give every run the laps of the dummy agent; drive them if nobody has."""
    dummy = next((run.dummy for run in runs if run.dummy is not None), None)
    if dummy is None:
        dummy = _drive_dummy(runs[0], output / 'dummy.json', console)
    for run in runs:
        run.dummy = run.dummy or dummy


def _drive_dummy(run: Run, path: Path, console: Console) -> Results:
    """Return laps of the dummy agent in a run's simulator, out of a file as far as it has them."""
    simulator = 'fast' if run.in_carracing else run.simulator
    seeds = range(DUMMY_SEED, DUMMY_SEED + (DUMMY_LAPS if run.in_carracing else FEWER_LAPS))
    with locked(path):
        return _dummy_laps(path, simulator, seeds, console)


def _dummy_laps(path: Path, simulator: str, seeds: range, console: Console) -> Results:
    """Return laps of the dummy agent; those that the file lacks are driven."""
    source = PolicySource(RANDOM)
    dummy = resume(path, source.identity(), simulator, seeds, simulator_source(simulator))
    todo = [seed for seed in seeds if seed not in dummy.laps]
    if not todo:
        return dummy
    dummy.wanted, dummy.machine = len(seeds), describe_machine()
    say(console, f'no laps of the dummy agent: driving {len(todo)} now')

    def write() -> None:
        try:
            write_json(path, dummy)
        except OSError as error:
            raise EvaluationError(f'{path} cannot be written: {error.strerror}') from None

    if keep_laps(drive_laps(source, todo, simulator=simulator, processes=cores()), dummy, console,
                 write):
        say(console, f'stopped; {len(dummy.laps)} laps are in {path}, from where the same command '
                     'goes on')
        raise KeyboardInterrupt
    return dummy


def _trajectories(
    run: Run, count: int, console: Console,
) -> Iterator[tuple[str, Trajectory]]:
    """Drive laps of a run's model once more; yield heading and lap; a bad model is a problem."""
    # other simulators have no track that could be drawn
    if not count or run.model is None or not run.in_carracing:
        return
    try:
        simulator = make_simulator('fast')
        policy = PolicySource(MODEL, str(run.model)).open(simulator.frame_seconds)
        limit_torch_threads()
        for heading, seed in _interesting_laps(run, count):
            say(console, f'driving track {seed} to draw it')
            trajectory = drive_trajectory(simulator, policy, seed)
            _compare_with_record(run, trajectory.lap)
            yield heading, trajectory
    except BridgeError as error:
        run.problems.append(f'No laps are shown: {error}.')


def _compare_with_record(run: Run, lap: Lap) -> None:
    """Note when a lap is not what the evaluation has of the same track."""
    known = run.evaluation.laps.get(lap.seed) if run.evaluation is not None else None
    if known is not None and known != lap:
        run.problems.append(
            f'Track {lap.seed} was {known.episode_return:.1f} points in the evaluation and is '
            f'{lap.episode_return:.1f} now: the model or the settings are not those of the '
            'evaluation.')


def _interesting_laps(run: Run, count: int) -> list[tuple[str, int]]:
    """Return heading and seed of the best, the median and the worst test lap, then others."""
    if run.evaluation is None:
        return [(f'Test track {seed}', seed) for seed in range(DUMMY_SEED, DUMMY_SEED + count)]
    laps = sorted(run.evaluation.ordered, key=lambda lap: -lap.episode_return)
    headings = {0: 'The best test lap'}
    headings.setdefault(len(laps) - 1, 'The worst test lap')
    headings.setdefault(len(laps) // 2, 'The median test lap')
    for place in range(len(laps)):
        headings.setdefault(place, f'Test lap {place + 1} of {len(laps)} by return')
    chosen = list(headings.items())[:count]
    return [(heading, laps[place].seed) for place, heading in sorted(chosen)]


def _distinct_names(runs: list[Run]) -> None:
    """Give runs of the same name a number each."""
    names = [run.name for run in runs]
    for run in runs:
        if names.count(run.name) > 1:
            run.name = f'{run.name} ({run.path.resolve().parent.name})'
    if len({run.name for run in runs}) < len(runs):
        for number, run in enumerate(runs, 1):
            run.name = f'{run.name} {number}'


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EvaluationError(f'{folder} cannot be made: {error.strerror}') from None


def _as_json(runs: list[Run]) -> dict[str, Any]:
    """Return the tables as JSON values."""
    return {
        run.name: {
            'objectives': {
                verdict.objective.key: {'passed': verdict.passed, 'text': verdict.text}
                for verdict in judge(run)},
            'figures': {
                figure.key: {
                    'section': figure.section, 'label': figure.label, 'stated': figure.stated,
                    'stated_value': figure.value, 'text': measured.text,
                    'value': measured.value}
                for figure, measured in compare(run)},
            'statistics': run.evaluation.statistics.to_json() if run.evaluation else None,
            'problems': run.problems,
        } for run in runs}
