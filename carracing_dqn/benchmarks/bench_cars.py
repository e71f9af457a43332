# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`carracing bench cars`: what one trainer takes in, and what many cars cost.

First a bag is recorded, then published as 1, 2, 4, ... cars to a real trainer over DDS, as fast
as it takes them: with learning off, and at the preset's replay ratio. Then real cars drive on
this host, with the trainer idle and busy. Rates are differences between two of the trainer's own
diagnostics; processor time and memory come from /proc. Whatever else runs on the machine takes its
share: the load average stands beside the figures.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from carracing_dqn.benchmarks.process_cost import children_of, cost_of, loopback_bytes
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.health import read_health
from msgs_bridge.listening_node import ListeningNode
from msgs_bridge.machine import describe_machine
from msgs_bridge.message_types import message_class
from msgs_bridge.qos import qos_profile
from rich.console import Console
from rich.table import Table

FED = (1, 2, 4, 8, 16, 32, 64)
DRIVING = (1, 2, 4, 8)
# nothing else of a run shall be measured
QUIET = {'validation_every_minutes': 0.0, 'validation_every_episodes': 0,
         'validation_every_decisions': 0, 'checkpoint_every_minutes': 0.0, 'run_minutes': 600.0,
         'replay_capacity': 200_000, 'epsilon_start': 0.3}
WARM_SECONDS = 4.0
START_SECONDS = 120.0
OFF = {'learning_starts': 199_999}
ON = {'learning_starts': 200}


class Trainer(ListeningNode):
    """Hears what one trainer says of itself."""

    def __init__(self, name: str) -> None:
        """Listen for the diagnostics of a node by its full name."""
        super().__init__('bench_cars')
        self.name = name
        self.figures: dict[str, float] = {}
        self.cars = 0
        self._node.create_subscription(
            message_class(topics.DIAGNOSTICS.type_name), topics.DIAGNOSTICS.name, self._take,
            qos_profile(topics.DIAGNOSTICS, depth=topics.BURST_DEPTH))
        self.start()

    def _take(self, message: Any) -> None:
        for said in read_health(message):
            if said.node == self.name:
                figures = {'heard': time.monotonic()}
                for key, value in said.values.items():
                    with contextlib.suppress(ValueError):
                        figures[key] = float(value)
                self.figures = figures

    def wait(self, name: str, least: float) -> dict[str, float]:
        """Return its figures once one of them has reached a value; raises BridgeError."""
        until = time.monotonic() + START_SECONDS
        while self.figures.get(name, 0.0) < least:
            if time.monotonic() > until:
                raise BridgeError(f'the trainer has no {name} of {least:g} after '
                                  f'{START_SECONDS:g} s')
            time.sleep(0.05)
        return self.figures

    def next(self) -> dict[str, float]:
        """Return figures that have not been heard yet."""
        before = self.figures.get('heard', 0.0)
        return self.wait('heard', before + 1e-6)


@contextlib.contextmanager
def running(words: list[str], log: Path) -> Iterator[subprocess.Popen]:
    """Run one of our programs while the block lasts."""
    with log.open('w') as file:
        process = subprocess.Popen(
            [sys.executable, '-m', *words], stdout=file, stderr=subprocess.STDOUT,
            env={**os.environ, 'OMP_NUM_THREADS': '1'}, start_new_session=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def measure(trainer: Trainer, seconds: float, groups: dict[str, list[int]]) -> dict[str, float]:
    """
    Return rates over some seconds.

    Args:
        trainer: is up and learning.
        seconds: how long to measure.
        groups: processes by a name, whose cost is wanted.
    """
    first, carried = trainer.next(), loopback_bytes()
    before = {name: sum(cost_of(pid).seconds for pid in pids) for name, pids in groups.items()}
    time.sleep(seconds)
    last = trainer.next()
    elapsed = last['heard'] - first['heard']
    result = {
        'transitions_per_second': (last['decisions'] - first['decisions']) / elapsed,
        'updates_per_second': (last['updates'] - first['updates']) / elapsed,
        'loopback_kB_per_second': (loopback_bytes() - carried) / elapsed / 1000}
    for name, pids in groups.items():
        costs = [cost_of(pid) for pid in pids]
        result[f'{name}_cpu'] = (sum(cost.seconds for cost in costs) - before[name]) / elapsed
        result[f'{name}_MB'] = sum(cost.resident for cost in costs) / 1e6
    return result


def overrides(changes: dict[str, Any]) -> list[str]:
    """Return NAME=VALUE of what differs from the preset."""
    return [f'{name}={value}' for name, value in {**QUIET, **changes}.items()]


def fed(bag: Path, preset: str, cars: int, changes: dict[str, Any], seconds: float,
        folder: Path) -> dict[str, float]:
    """Return what a trainer takes in of a bag that is published as some cars."""
    space = f'/bench_{os.getpid()}'
    trainer_words = [
        'trainer_node', '--ros-args', '-r', f'__ns:={space}', '-p', f'run:={folder / "run"}',
        '-p', f'preset:={preset}', '-p', "sources:='car_*'", '-p',
        'last_validation_seconds:=0.0', '-p', f"overrides:='{','.join(overrides(changes))}'"]
    trainer = Trainer(f'{space}/trainer_node')
    try:
        with running(trainer_words, folder / 'trainer.log') as learner, running(
                ['carracing_dqn.benchmarks.car_feeder_node', '--bag', str(bag), '--cars',
                 str(cars), '--namespace', space], folder / 'feeder.log') as feeder:
            trainer.wait('cars', cars)
            trainer.wait('decisions', 400)
            time.sleep(WARM_SECONDS)
            return measure(trainer, seconds, {'trainer': [learner.pid], 'feeder': [feeder.pid]})
    finally:
        trainer.close()
        shutil.rmtree(folder / 'run', ignore_errors=True)


def driven(preset: str, cars: int, changes: dict[str, Any], seconds: float,
           folder: Path) -> dict[str, float]:
    """Return what some cars on this host do, with `carracing train --cars`."""
    space = f'bench_{os.getpid()}'
    words = ['carracing_dqn.bringup', 'train', '--cars', str(cars), '--preset', preset, '--run',
             str(folder / 'run'), '--namespace', space]
    for pair in overrides(changes):
        words += ['--set', pair]
    trainer = Trainer(f'/{space}/trainer_node')
    try:
        with running(words, folder / 'train.log') as command:
            trainer.wait('cars', cars)
            trainer.wait('decisions', 400)
            time.sleep(WARM_SECONDS)
            groups: dict[str, list[int]] = {'trainer': [], 'car': []}
            for pid, line in children_of(command.pid).items():
                if '-m trainer_node' in line:
                    groups['trainer'].append(pid)
                elif f'/{space}/car_' in line:
                    groups['car'].append(pid)
            return measure(trainer, seconds, groups)
    finally:
        trainer.close()
        shutil.rmtree(folder / 'run', ignore_errors=True)


def record(folder: Path) -> Path:
    """Return a bag of two laps of the shipped model."""
    output = folder / 'laps'
    subprocess.run(
        [sys.executable, '-m', 'carracing_dqn.bringup', 'run', '--model', 'racing', '--laps', '2',
         '--output', str(output), '--namespace', f'bench_{os.getpid()}'],
        check=True, stdout=subprocess.DEVNULL)
    return output / 'bag'


def main(argv: list[str] | None = None) -> int:
    """Measure, print tables and write JSON if asked to; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='carracing bench cars', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--bag', type=Path, default=None,
                        help='what is published as cars (default: two laps, recorded first)')
    parser.add_argument('--preset', default='racing', help='preset to learn with')
    parser.add_argument('--fed', type=_numbers, default=FED, metavar='1,2,4',
                        help='numbers of cars that a bag is published as; 0 = none')
    parser.add_argument('--driving', type=_numbers, default=DRIVING, metavar='1,2,4',
                        help='numbers of cars that drive on this host; 0 = none')
    parser.add_argument('--seconds', type=float, default=10.0, help='length of each measurement')
    parser.add_argument('--json', type=Path, default=None, help='file for the figures')
    arguments = parser.parse_args(argv)
    console = Console()
    result: dict[str, Any] = {
        'machine': describe_machine(), 'seconds': arguments.seconds, 'preset': arguments.preset,
        'load_average_before': list(os.getloadavg()), 'fed': [], 'driving': []}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        fed_counts = [count for count in arguments.fed if count]
        if fed_counts:
            bag = arguments.bag.resolve() if arguments.bag else record(path)
            for cars in fed_counts:
                off, on = (fed(bag, arguments.preset, cars, changes, arguments.seconds, path)
                           for changes in (OFF, ON))
                result['fed'].append({'cars': cars, 'off': off, 'on': on})
            console.print(fed_table(result['fed']))
        for cars in filter(None, arguments.driving):
            idle, busy = (driven(arguments.preset, cars, changes, arguments.seconds, path)
                          for changes in (OFF, ON))
            result['driving'].append({'cars': cars, 'idle': idle, 'busy': busy})
        if result['driving']:
            console.print(driving_table(result['driving']))
    result['load_average_after'] = list(os.getloadavg())
    if arguments.json:
        from msgs_bridge.atomic_write import write_text
        write_text(arguments.json, json.dumps(result, indent=1) + '\n')
    return 0


def fed_table(rows: list[dict[str, Any]]) -> Table:
    """Return what one trainer takes in, by the number of cars."""
    table = Table(title='a bag published as cars: transitions that one trainer takes in')
    for column in ('cars', 'learning\noff,\n1/s', 'core ms\neach', 'learning\non,\n1/s',
                   'up-\ndates/s', 'core ms\neach', 'trainer\nMB'):
        table.add_column(column, justify='right')
    for row in rows:
        off, on = row['off'], row['on']
        table.add_row(
            str(row['cars']), f'{off["transitions_per_second"]:.0f}', _each(off, 'trainer'),
            f'{on["transitions_per_second"]:.0f}', f'{on["updates_per_second"]:.1f}',
            _each(on, 'trainer'), f'{on["trainer_MB"]:.0f}')
    return table


def driving_table(rows: list[dict[str, Any]]) -> Table:
    """Return what cars on this host do and cost, by their number."""
    table = Table(title=f'cars on this host ({os.cpu_count()} cores)')
    for column in ('cars', 'idle\ntrainer,\ndec./s', 'busy\ntrainer,\ndec./s', 'up-\ndates/s',
                   'core ms a\ndecision', 'MB a\ncar', 'trainer\ncores', 'loopback\nkB/s'):
        table.add_column(column, justify='right')
    for row in rows:
        idle, busy = row['idle'], row['busy']
        table.add_row(
            str(row['cars']), f'{idle["transitions_per_second"]:.0f}',
            f'{busy["transitions_per_second"]:.0f}', f'{busy["updates_per_second"]:.1f}',
            _each(idle, 'car'),
            f'{idle["car_MB"] / row["cars"]:.0f}', f'{busy["trainer_cpu"]:.2f}',
            f'{idle["loopback_kB_per_second"]:.0f}')
    return table


def _each(figures: dict[str, float], name: str) -> str:
    """Return what a transition costs of a core in ms, which holds on a busy machine, too."""
    return f'{1000 * figures[f"{name}_cpu"] / max(figures["transitions_per_second"], 1e-9):.2f}'


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(','))


if __name__ == '__main__':
    sys.exit(main())
