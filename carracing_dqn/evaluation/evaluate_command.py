# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing evaluate`: greedy laps on seeded tracks, in the unmodified environment."""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import dataclasses
import functools
import itertools
import os
from pathlib import Path
import re
import shlex
import sys
import time
from typing import Any

from carracing_dqn.evaluation.errors import EvaluationError, ResultsError
from carracing_dqn.evaluation.kept_laps import keep_laps
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.laps import Lap, picture_name
from carracing_dqn.evaluation.policies import MODEL, parse_policy, PolicySource
from carracing_dqn.evaluation.progress import summary_table
from carracing_dqn.evaluation.results import (
    locked, Results, resume, RUNS, write_csv, write_json,
)
from carracing_dqn.evaluation.sources import simulator_source
from carracing_dqn.evaluation.through_graph import drive_laps_through_graph, RunGraph
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import find_simulator, simulator_names
from carracing_dqn.simulation.registry import CARRACING
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.machine import cores, describe_machine
from msgs_bridge.terminal import say
from rich.console import Console

TEST_SEED = 100_000
"""First track of a test: training and validation draw theirs from lower seeds."""

DEFAULT_MODEL = 'racing'
KEPT_IN = 'RUN/evaluation-<time>.json, without a run runs/evaluate-<policy>-<time>.json'

LARGEST_SEED = 2**31 - 1
# more do not fit into a file that is read again
MOST_EPISODES = 100_000
MOST_REPEATS = 50
MOST_PROCESSES = 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        '--model', default=None, metavar='DIR|NAME',
        help='model folder, run folder (its best model) or name of a shipped model '
        f'(default: {DEFAULT_MODEL})')
    parser.add_argument(
        '--policy', default=MODEL, metavar='model|random|MODULE:CALLABLE',
        help='who drives: the model, the dummy agent (uniform random actions, seed document '
        '3.2.3), or your own: a function of the frame, or what makes an object with act(frame)')
    parser.add_argument('--episodes', type=int, default=100, metavar='N',
                        help='laps, each on a track of its own (default: %(default)s)')
    parser.add_argument('--seed', type=int, default=TEST_SEED, metavar='S',
                        help='seed of the first track; then S+1, ... (default: %(default)s)')
    parser.add_argument('--json', type=Path, metavar='FILE',
                        help='where laps and statistics are kept; an evaluation that was stopped '
                        f'goes on from it (default: {KEPT_IN})')
    parser.add_argument('--csv', type=Path, metavar='FILE', help='write a row a lap')
    parser.add_argument(
        '--simulator', default='gymnasium', metavar='NAME|MODULE:CLASS',
        help="gymnasium: the unmodified gymnasium.make('CarRacing-v3'); carracing (or fast): "
        'ours, equal to the byte; or another: '
        f'{", ".join(simulator_names())} are installed (default: %(default)s)')
    parser.add_argument('--processes', type=int, default=None, metavar='N',
                        help=f'processes that drive (default: {cores()}, the cores)')
    parser.add_argument('--pictures', type=Path, metavar='DIR',
                        help='a picture of every lap: the track from above, by speed and reward')
    parser.add_argument('--device', default='cpu', help='where a model computes, as PyTorch names '
                        'it (default: %(default)s)')
    parser.add_argument('--action-repeat', type=int, default=0, metavar='N',
                        help='frames a model holds an action (default: 0, as the model says)')
    parser.add_argument(
        '--through-graph', action='store_true',
        help='drive the same tracks over ROS topics, simulator and policy as processes')
    parser.add_argument('--bag', type=Path, metavar='DIR',
                        help='record the graph to a new bag (with --through-graph)')


def main(arguments: argparse.Namespace, *, run_graph: RunGraph | None = None) -> int:
    """
    Drive the laps; return the exit code, 130 after Ctrl-C or SIGTERM with the laps kept.

    Args:
        arguments: see `add_arguments`.
        run_graph: what drives laps over topics, for `--through-graph`.

    Raises:
        BridgeError: an option, a model, a policy or a file that cannot be used.
    """
    _check(arguments)
    find_simulator(arguments.simulator)
    console = Console()
    source = dataclasses.replace(
        parse_policy(arguments.policy, arguments.model or DEFAULT_MODEL, arguments.device),
        action_repeat=arguments.action_repeat)
    identity = source.identity()
    source = dataclasses.replace(source, weights_sha256=identity.get('weights_sha256', ''))
    with _place(arguments.json, source) as arguments.json:
        return _drive(arguments, source, identity, console, run_graph)


def _drive(
    arguments: argparse.Namespace, source: PolicySource, identity: dict[str, Any],
    console: Console, run_graph: RunGraph | None,
) -> int:
    """Drive the laps that are still to be driven; return the exit code."""
    seeds = range(arguments.seed, arguments.seed + arguments.episodes)
    simulator = 'graph' if arguments.through_graph else arguments.simulator
    results = resume(arguments.json, identity, simulator, seeds,
                     simulator_source(arguments.simulator))
    results.wanted = len(seeds)
    results.machine = describe_machine()
    limit_torch_threads()
    todo = [seed for seed in seeds if seed not in results.laps]
    _check_kept(arguments, results, todo)

    if len(todo) < len(seeds):
        say(console, f'{len(seeds) - len(todo)} of {len(seeds)} laps are in {arguments.json} '
                     'already')
    laps = _laps(arguments, source, todo, run_graph)
    interrupted = keep_laps(
        laps, results, console, functools.partial(_write, arguments, results))
    if results.laps:
        console.print(summary_table(source.name, results.ordered))
    for path in (arguments.json, arguments.csv):
        if path is not None and results.laps:
            say(console, f'wrote {path}')
    if interrupted:
        more = f'; the same command with --json {shlex.quote(str(arguments.json))} goes on'
        sys.stderr.write(f'stopped after {len(results.laps)} of {len(seeds)} laps'
                         f'{more if results.laps else ""}\n')
        return INTERRUPTED
    return 0


@contextlib.contextmanager
def _place(named: Path | None, source: PolicySource) -> Iterator[Path]:
    """Yield where laps are kept, which no other process writes to inside the block."""
    with contextlib.ExitStack() as stack:
        if named is not None:
            _check_place(named)
            stack.enter_context(locked(named))
        for path in _new_files(source) if named is None else ():
            _check_place(path)
            if path.parent == RUNS and not RUNS.exists():
                RUNS.mkdir(exist_ok=True)
                stack.callback(_remove_empty, RUNS)
            with contextlib.suppress(ResultsError):
                stack.enter_context(locked(path))
                # who had it may have ended in between
                if not path.exists():
                    named = path
                    break
        yield named


def _remove_empty(folder: Path) -> None:
    """Remove a folder in which nothing was kept."""
    with contextlib.suppress(OSError):
        folder.rmdir()


def _new_files(source: PolicySource) -> Iterator[Path]:
    """Yield where laps may be kept when nobody has said so: with the run, or below `runs`."""
    folder = source.run_folder
    kind = 'evaluation' if folder else 'evaluate-' + re.sub(r'[^\w.-]+', '-', source.name)
    stem = f'{kind}-{time.strftime("%Y%m%d-%H%M%S")}'
    for more in itertools.chain([''], itertools.count(-1, -1)):
        path = Path(folder or RUNS) / f'{stem}{more}.json'
        if not path.exists():
            yield path


def _laps(
    arguments: argparse.Namespace, source: PolicySource, todo: list[int],
    run_graph: RunGraph | None,
) -> Iterator[Lap]:
    if arguments.through_graph:
        if run_graph is None:
            raise EvaluationError('--through-graph is an option of the carracing command')
        return drive_laps_through_graph(source, todo, run_graph, bag=arguments.bag)
    pictures = None
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
        pictures = str(arguments.pictures)
    return drive_laps(source, todo, simulator=arguments.simulator,
                      processes=arguments.processes or cores(), pictures=pictures)


def _write(arguments: argparse.Namespace, results: Results) -> None:
    """Write the files that were asked for; raises EvaluationError."""
    for path, write in ((arguments.json, write_json), (arguments.csv, write_csv)):
        if path is None or not results.laps:
            continue
        try:
            write(path, results)
        except OSError as error:
            raise EvaluationError(f'{path} cannot be written: {error.strerror}') from None


def _check(arguments: argparse.Namespace) -> None:
    """Raise EvaluationError for options that cannot be, before anything is driven."""
    if arguments.model is not None and arguments.policy != MODEL:
        raise EvaluationError(f'--model {arguments.model} and --policy {arguments.policy}: only '
                              'one can drive; leave one of them out')
    for name, most in (('episodes', MOST_EPISODES), ('processes', MOST_PROCESSES)):
        value = getattr(arguments, name)
        if value is not None and not 1 <= value <= most:
            raise EvaluationError(f'--{name} is {value}; accepted: 1 to {most}')
    if not 0 <= arguments.seed <= LARGEST_SEED - arguments.episodes:
        raise EvaluationError(
            f'--seed is {arguments.seed}; accepted: 0 to {LARGEST_SEED - arguments.episodes}')
    if not 0 <= arguments.action_repeat <= MOST_REPEATS:
        raise EvaluationError(
            f'--action-repeat is {arguments.action_repeat}; accepted: 0 to {MOST_REPEATS}')
    if arguments.action_repeat and (arguments.through_graph or arguments.policy != MODEL):
        raise EvaluationError('--action-repeat is for models that are driven in process')
    if arguments.device != 'cpu' and (arguments.through_graph or arguments.policy != MODEL):
        raise EvaluationError('--device is for models that are driven in process')
    if arguments.through_graph and arguments.simulator not in CARRACING:
        raise EvaluationError(f'--through-graph drives in CarRacing, and not in '
                              f'{arguments.simulator}')
    if arguments.processes is not None and arguments.through_graph:
        raise EvaluationError('--processes is for laps in process; --through-graph has its own')
    if arguments.bag is not None and not arguments.through_graph:
        raise EvaluationError('--bag records topics, which only --through-graph has')
    if arguments.pictures is not None and arguments.through_graph:
        raise EvaluationError('--pictures looks into the simulator, which --through-graph hides')
    for path in filter(None, (arguments.json, arguments.csv)):
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise EvaluationError(f'{path}: there is no folder {folder}')
        if path.exists() and not path.is_file():
            raise EvaluationError(f'{path} cannot be written: it is no file')
    if arguments.json is not None and arguments.csv is not None and (
            os.path.realpath(arguments.json) == os.path.realpath(arguments.csv)):
        raise EvaluationError(f'--json and --csv are both {arguments.csv}; name two files')


def _check_kept(arguments: argparse.Namespace, results: Results, todo: list[int]) -> None:
    """Raise EvaluationError where laps that are kept already lack what is asked of them."""
    another = 'and only laps that are driven give one; name another --json'
    if arguments.bag is not None and not todo:
        raise EvaluationError(f'--bag: all laps are in {arguments.json} already, {another}')
    if arguments.pictures is not None:
        bare = [seed for seed in results.laps
                if not (arguments.pictures / picture_name(seed)).exists()]
        if bare:
            raise EvaluationError(
                f'--pictures: {len(bare)} of the laps in {arguments.json} have none in '
                f'{arguments.pictures}, {another}')


def _check_place(path: Path) -> None:
    """Raise EvaluationError when a file cannot be kept, before anything is driven for it."""
    folder = path.parent if path.parent.is_dir() else path.parent.parent
    if not os.access(folder, os.W_OK):
        raise EvaluationError(f'{folder.resolve()} cannot be written, where the laps are to be '
                              'kept; --json names another place')
