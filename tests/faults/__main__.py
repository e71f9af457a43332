# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Try faults for some minutes: `make faults MINUTES=60 SEED=1`.

Each of the four tables has a quarter of the time. Every row is tried once, in an order that the
seed makes, then rows are drawn by weight. What was tried and survived is written as `faults.md`
and `faults.json` into the output folder, after each fault, so that a run may be stopped.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
import os
from pathlib import Path
from random import Random
import signal
import sys
import time

from faults import report, tables
from faults.command_faults import try_command_fault
from faults.file_faults import Originals, try_file_fault
from faults.message_runner import try_message_fault
from faults.outcome import Outcome
from faults.process_faults import try_process_fault
from faults.running_graph import RunningGraph
from msgs_bridge.host_only import stay_on_this_host

WELL_SECONDS = 120.0

# how the time is shared
SHARES = {'message': 0.4, 'process': 0.2, 'command': 0.25, 'file': 0.15}


def draw(rows: Sequence, random: Random) -> Iterator:
    """Yield every row once, then rows by weight, without end."""
    order = list(rows)
    random.shuffle(order)
    yield from order
    while True:
        yield random.choices(rows, [row.weight for row in rows])[0]


class Trial:
    """
    A run of the harness.

    Attributes:
        outcomes: all so far.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        """Write into a new folder."""
        folder.mkdir(parents=True)
        self.folder = folder.resolve()
        self.seed = seed
        self.began = time.monotonic()
        self.outcomes: list[Outcome] = []
        self._graphs = 0
        self._graph: RunningGraph | None = None

    def note(self, outcome: Outcome) -> None:
        """Keep, print and write an outcome."""
        self.outcomes.append(outcome)
        sys.stdout.write(f'{outcome.line()}\n')
        sys.stdout.flush()
        survived = sum(one.survived for one in self.outcomes)
        minutes = (time.monotonic() - self.began) / 60
        report.write(self.outcomes, self.folder,
                     f'{survived} of {len(self.outcomes)} faults survived in {minutes:.0f} '
                     f'minutes, seed {self.seed}, load {os.getloadavg()[1]:.1f} '
                     f'on {os.cpu_count()} cores')

    def graph(self) -> RunningGraph:
        """Return a graph that is well, a new one if the last is not."""
        if self._graph is None:
            self._graphs += 1
            folder = self.folder / f'graph{self._graphs}'
            folder.mkdir()
            self._graph = RunningGraph(folder, f'faults{self._graphs}')
            self._graph.wait_until_well(WELL_SECONDS)
            self._graph.spin(2.0)
        return self._graph

    def end_graph(self) -> None:
        """Stop the graph and look at the bags it leaves."""
        graph, self._graph = self._graph, None
        if graph is not None:
            self.note(graph.end())

    def in_graph(self, attempt: Callable) -> Callable:
        """Return what tries a row in a graph that is well, and ends one that is not."""
        def tried(row: object, seed: int) -> None:
            try:
                graph = self.graph()
            except TimeoutError as error:
                self.note(Outcome('process', 'start', 'everything', seed, [str(error)]))
                self.end_graph()
                return
            self.note(attempt(graph, row, seed))
            if graph.what_is_wrong():
                self.end_graph()
        return tried

    def run(self, rows: Sequence, attempt: Callable, seconds: float) -> None:
        """Try rows of one table for some time."""
        random = Random(self.seed)
        until = time.monotonic() + seconds
        for row in draw(rows, random):
            if time.monotonic() > until:
                break
            attempt(row, random.randrange(10**6))
        self.end_graph()

    def run_group(self, group: str, seconds: float) -> None:
        """Try one table for some time."""
        place = self.folder / 'copy'
        if group == 'message':
            self.run(tables.MESSAGES, self.in_graph(try_message_fault), seconds)
        elif group == 'process':
            self.run(tables.PROCESSES, self.in_graph(try_process_fault), seconds)
        elif group == 'command':
            self.run(tables.COMMANDS, lambda row, seed: self.note(
                try_command_fault(place, row, seed)), seconds)
        else:
            originals = Originals(self.folder / 'originals')
            self.run(tables.FILES, lambda row, seed: self.note(
                try_file_fault(originals, place, row, seed)), seconds)


def main() -> int:
    """Run the harness; return 1 if something was not survived."""
    parser = argparse.ArgumentParser(prog='faults', description=__doc__)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--output', type=Path, default=None, help='new folder')
    parser.add_argument('--only', choices=tuple(SHARES), default=None, help='one table alone')
    arguments = parser.parse_args()
    # in the background of a script and below nohup these are ignored, and by all that is started
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ.setdefault('ROS_DOMAIN_ID', '77')
    os.environ['OMP_NUM_THREADS'] = '1'
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    stay_on_this_host()
    folder = arguments.output or Path('runs') / time.strftime('faults-%Y%m%d-%H%M%S')
    trial = Trial(folder, arguments.seed)
    shares = {arguments.only: 1.0} if arguments.only else SHARES
    try:
        for group, share in shares.items():
            trial.run_group(group, 60 * arguments.minutes * share)
    except KeyboardInterrupt:
        trial.end_graph()
    sys.stdout.write(report.summary(trial.outcomes))
    return 0 if all(one.survived for one in trial.outcomes) else 1


if __name__ == '__main__':
    sys.exit(main())
