# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The learning graph against one process that does the same work, and the graph while recording.

Each is run in turn, several rounds in one go, with the same preset; rates are read from the
records that the trainer writes (`updates.csv`), from the end of the first rows to the last, so
that starting up does not count. The graph has three ROS processes and DDS in between; the loop
has none of it.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
import csv
import json
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile

from msgs_bridge.errors import BridgeError
from rich.console import Console
from rich.table import Table
from trainer_node.run_record import UPDATES_PER_ROW

# Validation would be measured, too; it takes the same time in both, but not at the same moments.
UNVALIDATED = {
    'validation_every_minutes': 0.0, 'validation_every_decisions': 0,
    'validation_every_episodes': 0, 'epsilon_start': 0.3, 'learning_starts': 1000,
    'checkpoint_every_minutes': 0.0,
}


def overrides(minutes: float) -> list[str]:
    """Return the --set words of a measured run."""
    values = {**UNVALIDATED, 'run_minutes': minutes}
    return [word for name, value in values.items() for word in ('--set', f'{name}={value}')]


def rates(run: Path) -> tuple[float, float]:
    """
    Return decisions/s and updates/s of a run, start-up left out.

    Raises:
        BridgeError: it was over before there were two rows to compare.
    """
    with (run / 'updates.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    if len(rows) < 2:
        raise BridgeError(f'a run ended after fewer than {2 * UPDATES_PER_ROW} updates: give '
                          '--minutes more')
    first, last = rows[0], rows[-1]
    seconds = float(last['wall_seconds']) - float(first['wall_seconds'])
    return tuple((float(last[name]) - float(first[name])) / seconds
                 for name in ('decisions', 'updates'))


def run_graph(preset: str, minutes: float, run: Path, *, bag: bool = False) -> None:
    """Train through the graph."""
    words = ['train', '--preset', preset, '--run', str(run), *overrides(minutes)]
    subprocess.run([sys.executable, '-m', 'carracing_dqn.bringup', *words,
                    *(['--bag'] if bag else [])],
                   check=True, stdout=subprocess.DEVNULL)


def run_loop(preset: str, minutes: float, run: Path) -> None:
    """Train in one process."""
    subprocess.run(
        [sys.executable, '-m', 'carracing_dqn.benchmarks.single_process_loop',
         '--preset', preset, '--run',
         str(run), '--minutes', str(minutes), *overrides(minutes)],
        check=True, stdout=subprocess.DEVNULL)


def measure(preset: str, minutes: float, rounds: int) -> dict[str, list[tuple[float, float]]]:
    """Run each contestant in turn; return its (decisions/s, updates/s) of every round."""
    contestants: dict[str, Callable[[Path], None]] = {
        'single process': lambda run: run_loop(preset, minutes, run),
        'graph': lambda run: run_graph(preset, minutes, run),
        'graph, recording': lambda run: run_graph(preset, minutes, run, bag=True),
    }
    results: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, contestant in contestants.items():
            with tempfile.TemporaryDirectory() as folder:
                run = Path(folder) / 'run'
                contestant(run)
                results[name].append(rates(run))
    return results


def main(argv: list[str] | None = None) -> int:
    """Measure, print a table and write JSON if asked to; return the exit code."""
    parser = argparse.ArgumentParser(prog='carracing bench graph', description=__doc__)
    parser.add_argument('--preset', default='racing', help='preset to learn with')
    parser.add_argument('--minutes', type=float, default=1.0, help='length of each run')
    parser.add_argument('--rounds', type=int, default=3, help='runs of each contestant')
    parser.add_argument('--json', type=Path, default=None, help='file for the figures')
    arguments = parser.parse_args(argv)
    results = measure(arguments.preset, arguments.minutes, arguments.rounds)
    table = Table(title=f'{arguments.preset}: medians of {arguments.rounds} rounds of '
                        f'{arguments.minutes:g} min, in turn')
    for column in ('', 'decisions/s', 'updates/s', 'against one process', 'against the graph'):
        table.add_column(column, justify='right' if column else 'left')

    def ratio(name: str, base: str) -> float:
        return statistics.median(
            ours[1] / theirs[1] for ours, theirs in zip(results[name], results[base]))

    for name, figures in results.items():
        decisions, updates = (statistics.median(column) for column in zip(*figures))
        table.add_row(name, f'{decisions:.0f}', f'{updates:.1f}',
                      f'{ratio(name, "single process"):.2f}', f'{ratio(name, "graph"):.2f}')
    Console().print(table)
    if arguments.json:
        from msgs_bridge.atomic_write import write_text
        write_text(arguments.json, json.dumps(results, indent=1) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
