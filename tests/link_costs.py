# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Where the policy of a car runs, measured: beside the car, or beside the trainer.

`PYTHONPATH=tests python -m link_costs` makes two hosts (network namespaces, as root), a trainer
on one and a simulator on the other, and prints decisions a second, bytes over the wire and
processor time of the car for each decision, with raw and with compressed images.
"""
from __future__ import annotations

import argparse
import json
from pathlib import Path
import signal
import sys
import tempfile
import time

from carracing_dqn.benchmarks.process_cost import cost_of
from network_hosts import two_hosts
from rich.console import Console
from rich.table import Table
from test_graph_hosts import Hosts, LISTENER

CAR = ('-r', '__ns:=/car_0')
POLICY = (*CAR, '-r', 'weights:=/weights', '-p', "model:=''", '-p', 'explore:=true')


def nodes(words: tuple[str, ...], compressed: bool, name: str) -> tuple[str, ...]:
    """Return the words of a node of the car that may send or take compressed images."""
    return (*words, '-p', f'{name}:={str(compressed).lower()}')


def measure(
    folder: Path, preset: str, delay: float, beside_car: bool, compressed: bool, seconds: float,
) -> dict[str, float]:
    """Return what a decision costs, and how many there are a second."""
    with two_hosts(delay=delay) as (pair, wire):
        hosts = Hosts(pair, folder)
        hosts.start(hosts.here, 'listener.log', '-c', LISTENER)
        hosts.start(
            hosts.here, 'trainer.log', '-m', 'trainer_node', '--ros-args', '-p',
            f'run:={folder / "run"}', '-p', f'preset:={preset}', '-p', "sources:='/car_*'", '-p',
            'last_validation_seconds:=0.0', '-p', "overrides:='learning_starts=49999,"
            "replay_capacity=50000,validation_every_minutes=0.0,run_minutes=600.0'")
        car = [
            hosts.start(hosts.there, 'simulator.log', *nodes((
                '-m', 'carracing_sim_node', '--ros-args', *CAR, '-p', 'action_repeat:=4', '-p',
                'wait_for_subscribers:=1', '-p', 'publish_clock:=false'),
                compressed, 'image_compressed')),
            hosts.start(hosts.there if beside_car else hosts.here, 'policy.log', *nodes((
                '-m', 'dqn_policy_node', '--ros-args', *POLICY), compressed, 'camera_compressed'))]
        hosts.until(0, 100)
        before, carried = hosts.learned(0), wire.bytes
        spent = [cost_of(process.pid).seconds for process in car]
        began = time.monotonic()
        time.sleep(seconds)
        decisions, elapsed = hosts.learned(0) - before, time.monotonic() - began
        car_spent = [cost_of(process.pid).seconds - old for process, old in zip(car, spent)]
        result = {
            'delay_ms': 1000 * delay, 'beside_car': beside_car, 'compressed': compressed,
            'decisions_per_second': decisions / elapsed,
            'wire_bytes_per_decision': (wire.bytes - carried) / max(decisions, 1),
            'simulator_ms': 1000 * car_spent[0] / max(decisions, 1),
            'policy_ms': 1000 * car_spent[1] / max(decisions, 1)}
        for process in car:
            process.send_signal(signal.SIGINT)
        return result


def main() -> int:
    """Measure every case; print a table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--preset', default='racing')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--delays', type=float, nargs='+', default=[0.0, 0.02], metavar='SECONDS')
    parser.add_argument('--json', type=Path, default=None, help='file for the figures')
    arguments = parser.parse_args()
    table = Table(title='a car on one host, the trainer on another')
    for column in ('delay\nms', 'policy\nbeside', 'images', 'decisions/s', 'wire kB\na decision',
                   'simulator\ncore ms', 'policy\ncore ms'):
        table.add_column(column, justify='right')
    results = []
    for delay in arguments.delays:
        for beside_car in (True, False):
            for compressed in (False, True):
                with tempfile.TemporaryDirectory() as folder:
                    one = measure(Path(folder), arguments.preset, delay, beside_car, compressed,
                                  arguments.seconds)
                results.append(one)
                table.add_row(
                    f'{one["delay_ms"]:.0f}', 'car' if beside_car else 'trainer',
                    'png' if compressed else 'raw', f'{one["decisions_per_second"]:.0f}',
                    f'{one["wire_bytes_per_decision"] / 1000:.1f}', f'{one["simulator_ms"]:.2f}',
                    f'{one["policy_ms"]:.2f}')
    Console().print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
