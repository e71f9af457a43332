# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing evaluate`: greedy laps on seeded tracks, in the unmodified environment."""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import dataclasses
import functools
import os
from pathlib import Path
import re
import shlex
import sys
import time

from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.kept_laps import keep_laps
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.policies import MODEL, parse_policy, PolicySource
from carracing_dqn.evaluation.progress import summary_table
from carracing_dqn.evaluation.results import Results, resume, RUNS, write_csv, write_json
from carracing_dqn.evaluation.through_graph import drive_laps_through_graph, RunGraph
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import find_simulator, simulator_names
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.machine import cores, describe_machine
from msgs_bridge.terminal import say
from rich.console import Console

TEST_SEED = 100_000
"""First track of a test: training and validation draw theirs from lower seeds."""

DEFAULT_MODEL = 'racing'
KEPT_IN = 'RUN/evaluation-<time>.json, without a run runs/evaluate-<policy>-<time>.json'

LARGEST_SEED = 2**31 - 1
MOST_REPEATS = 50


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
    parser.add_argument('--processes', type=int, default=cores(), metavar='N',
                        help='processes that drive (default: %(default)s, the cores)')
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
    seeds = range(arguments.seed, arguments.seed + arguments.episodes)
    simulator = 'graph' if arguments.through_graph else arguments.simulator
    identity = source.identity()
    if arguments.json is None:
        arguments.json = _new_file(source)
    _check_place(arguments.json)
    results = resume(arguments.json, identity, simulator, seeds)
    results.wanted = len(seeds)
    results.machine = describe_machine()
    limit_torch_threads()
    todo = [seed for seed in seeds if seed not in results.laps]

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


def _new_file(source: PolicySource) -> Path:
    """Return where laps are kept when nobody has said so: with the run, or below `runs`."""
    folder = source.run_folder
    kind = 'evaluation' if folder else 'evaluate-' + re.sub(r'[^\w.-]+', '-', source.name)
    stem = f'{kind}-{time.strftime("%Y%m%d-%H%M%S")}'
    places = (Path(folder or RUNS) / f'{stem}{more}.json' for more in ('', *range(-1, -1000, -1)))
    return next(path for path in places if not path.exists())


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
                      processes=arguments.processes, pictures=pictures)


def _write(arguments: argparse.Namespace, results: Results) -> None:
    """Write the files that were asked for; raises EvaluationError."""
    for path, write in ((arguments.json, write_json), (arguments.csv, write_csv)):
        if path is None or not results.laps:
            continue
        try:
            if path.parent == RUNS:
                path.parent.mkdir(exist_ok=True)
            write(path, results)
        except OSError as error:
            raise EvaluationError(f'{path} cannot be written: {error.strerror}') from None


def _check(arguments: argparse.Namespace) -> None:
    """Raise EvaluationError for options that cannot be, before anything is driven."""
    if arguments.model is not None and arguments.policy != MODEL:
        raise EvaluationError(f'--model {arguments.model} and --policy {arguments.policy}: only '
                              'one can drive; leave one of them out')
    if arguments.episodes < 1:
        raise EvaluationError(f'--episodes is {arguments.episodes}; accepted: 1 or more')
    if arguments.processes < 1:
        raise EvaluationError(f'--processes is {arguments.processes}; accepted: 1 or more')
    if not 0 <= arguments.seed <= LARGEST_SEED - arguments.episodes:
        raise EvaluationError(
            f'--seed is {arguments.seed}; accepted: 0 to {LARGEST_SEED - arguments.episodes}')
    if not 0 <= arguments.action_repeat <= MOST_REPEATS:
        raise EvaluationError(
            f'--action-repeat is {arguments.action_repeat}; accepted: 0 to {MOST_REPEATS}')
    if arguments.action_repeat and (arguments.through_graph or arguments.policy != MODEL):
        raise EvaluationError('--action-repeat is for models that are driven in process')
    if arguments.bag is not None and not arguments.through_graph:
        raise EvaluationError('--bag records topics, which only --through-graph has')
    if arguments.pictures is not None and arguments.through_graph:
        raise EvaluationError('--pictures looks into the simulator, which --through-graph hides')
    for path in (arguments.json, arguments.csv):
        if path is not None and not path.resolve().parent.is_dir():
            raise EvaluationError(f'{path}: there is no folder {path.resolve().parent}')


def _check_place(path: Path) -> None:
    """Raise EvaluationError when a file cannot be kept, before anything is driven for it."""
    folder = path.parent if path.parent.is_dir() else path.parent.parent
    if not os.access(folder, os.W_OK):
        raise EvaluationError(f'{folder.resolve()} cannot be written, where the laps are to be '
                              'kept; --json names another place')
