# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`carracing bench transport`: images of a camera on this host, in our profile and in shared memory.

One process publishes images, others hear them, each a plain rclpy node. The profile of a closed
graph (sockets on 127.0.0.1) and Fast DDS as it is by itself (shared memory) take turns within each
round. Figures are medians over rounds, those of heard images of the reader that heard least.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
import multiprocessing
import os
from pathlib import Path
from statistics import median
import sys

from carracing_dqn.benchmarks.camera_node import hear, publish
from msgs_bridge.atomic_write import write_text
from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.host_only import PROFILE_VARIABLE, RANGE, SKIP_VARIABLE, UNPROFILED
from msgs_bridge.machine import describe_machine
from rich.console import Console
from rich.table import Table

DOMAIN = 96
SOCKETS, SHARED = 'sockets', 'shared memory'
RELIABILITIES = ('best_effort', 'reliable')


@contextlib.contextmanager
def transport(name: str) -> Iterator[None]:
    """Let processes that are started in the block use one of the two."""
    before = dict(os.environ)
    for variable in (PROFILE_VARIABLE, SKIP_VARIABLE, RANGE):
        os.environ.pop(variable, None)
    os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
    if name == SOCKETS:
        before_rclpy()
    else:
        os.environ.update({RANGE: UNPROFILED, SKIP_VARIABLE: '1'})
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def measure(shape: tuple[int, int], rate: float, seconds: float, reliability: str,
            readers: int) -> dict[str, float]:
    """Return the share of images that were heard and their median age, in ms."""
    spawn = multiprocessing.get_context('spawn')
    count = round(rate * seconds)
    pipes = [spawn.Pipe(duplex=False) for _ in range(readers)]
    processes = [spawn.Process(target=hear, args=(seconds, reliability, sender))
                 for _, sender in pipes]
    processes.append(spawn.Process(
        target=publish, args=(shape, rate, count, reliability, readers)))
    for process in processes:
        process.start()
    ages = [receiver.recv() for receiver, _ in pipes]
    for process in processes:
        process.join()
    everyone = [age for of_one in ages for age in of_one]
    return {'heard': min(map(len, ages)) / count,
            'age_ms': 1e3 * median(everyone) if everyone else float('nan')}


def main(argv: list[str] | None = None) -> int:
    """Measure, print a table and write JSON if asked to; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='carracing bench transport', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--size', type=_size, default=(640, 480), metavar='WIDTHxHEIGHT',
                        help='of an image')
    parser.add_argument('--rate', type=float, default=30.0, help='images a second')
    parser.add_argument('--seconds', type=float, default=8.0, help='length of a measurement')
    parser.add_argument('--readers', type=int, default=2, help='processes that hear them')
    parser.add_argument('--rounds', type=int, default=3, help='rounds to take the median of')
    parser.add_argument('--json', type=Path, default=None, help='file for the figures')
    arguments = parser.parse_args(argv)
    width, height = arguments.size
    rounds: dict[str, list[dict[str, float]]] = {}
    for _ in range(arguments.rounds):
        for reliability in RELIABILITIES:
            for name in (SOCKETS, SHARED):
                with transport(name):
                    rounds.setdefault(f'{name}, {reliability}', []).append(measure(
                        (height, width), arguments.rate, arguments.seconds, reliability,
                        arguments.readers))
    table = Table(title=f'{width}x{height} at {arguments.rate:g} Hz, {arguments.readers} readers')
    for column in ('transport', 'heard', 'lowest round', 'median age, ms'):
        table.add_column(column, justify='left' if column == 'transport' else 'right')
    for name, figures in rounds.items():
        heard = [one['heard'] for one in figures]
        table.add_row(name, f'{median(heard):.1%}', f'{min(heard):.1%}',
                      f'{median(one["age_ms"] for one in figures):.1f}')
    Console().print(table)
    if arguments.json:
        write_text(arguments.json, json.dumps({
            'machine': describe_machine(), 'load_average': list(os.getloadavg()),
            'rounds': rounds}, indent=1) + '\n')
    return 0


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition('x')
    return int(width), int(height)


if __name__ == '__main__':
    sys.exit(main())
