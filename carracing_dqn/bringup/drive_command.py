# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing drive --join`: one more car for a trainer that runs elsewhere."""
from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
import shlex
import time

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.graph import car_graph, car_space, driver_seed, POLICY, SIMULATOR
from carracing_dqn.bringup.join_node import find_trainer, free_car
from carracing_dqn.bringup.monitor import absolute_namespace, GraphState, Monitor
from carracing_dqn.bringup.run_folders import default_folder, new_folder
from carracing_dqn.bringup.supervise import check_machine, run_to_the_end
from carracing_dqn.bringup.vehicle import vehicle_of
from carracing_dqn.simulation import find_simulator
from carracing_dqn.simulation.profiles import seen_from
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.seeds import epsilon_exponent, MAX_CARS, training_seed
from msgs_bridge.topics import WEIGHTS
from rich.console import Console
from rich.table import Table
from rich.text import Text

WAIT_SECONDS = 60.0
# discovery may take so long
GONE_SECONDS = 6.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing drive`."""
    parser.add_argument('--join', action='store_true',
                        help='drive for a trainer, by its weights (without it: carracing run)')
    parser.add_argument('--car', type=int, default=None, metavar='NUMBER',
                        help='number of this car (default: the lowest that is free)')
    parser.add_argument('--simulator', default='carracing', metavar='NAME|PROFILE|MODULE:CLASS',
                        help='what to drive in, the same as the trainer (default: %(default)s)')
    parser.add_argument('--compressed', action='store_true',
                        help='send images as png: a ninth of the bytes, half a millisecond more')
    parser.add_argument('--wait', type=float, default=WAIT_SECONDS, metavar='SECONDS',
                        help='how long to look for the trainer, and to drive on without one that '
                        'has gone (default: %(default)s)')
    parser.add_argument('--output', type=Path, default=None,
                        help='folder for the logs (default: runs/car-<time>)')
    parser.add_argument('--namespace', default='', help='ROS namespace of the trainer')


def main(arguments: argparse.Namespace) -> int:
    """Drive until the user stops it or the trainer is gone for long; return the exit code."""
    if not arguments.join:
        raise BridgeError('carracing drive needs --join; carracing run drives without a trainer')
    if arguments.car is not None and not 0 <= arguments.car < MAX_CARS:
        raise BridgeError(f'--car is {arguments.car}; accepted: 0 to {MAX_CARS - 1}')
    if not 0 < arguments.wait <= 1e6:
        raise BridgeError(f'--wait is {arguments.wait:g}; accepted: above 0, up to 1000000')
    namespace = absolute_namespace(arguments.namespace)
    find_simulator(arguments.simulator)
    vehicle = vehicle_of(arguments.simulator)
    check_machine()
    trainer = find_trainer(namespace, arguments.wait)
    # a profile is another path from each place, and its values cannot be seen from here
    if Path(trainer.simulator).name != Path(arguments.simulator).name:
        raise BridgeError(f'the trainer learns in {trainer.simulator!r}; start this car with '
                          f'--simulator {shlex.quote(trainer.simulator)}')
    car = free_car(trainer.taken) if arguments.car is None else arguments.car
    if car in trainer.taken:
        raise BridgeError(f'{namespace}/{car_space(car)} drives already; give another --car')
    monitor = Monitor(f'{namespace}/{car_space(car)}')
    try:
        folder = new_folder(arguments.output or default_folder(f'car_{car}'))
        done = trainer.episodes.get(f'{namespace}/{car_space(car)}', 0)
        graph = car_graph(
            car, vehicle=vehicle, compressed=arguments.compressed,
            simulator={**trainer.parameters, 'seed': training_seed(trainer.seed, car),
                       'seed_each_episode': True, 'first_episode': done,
                       'simulator': seen_from(arguments.simulator, folder)},
            seed=driver_seed(trainer.seed, done, car),
            exponent=epsilon_exponent(car, trainer.cars, trainer.spread))
        weights = f'{namespace}/{WEIGHTS.name}'
        without = Absence(lambda: monitor.publishers(weights) > 0)
        display = Display(
            monitor.state, lambda state, rows: car_table(state, rows, without.seconds),
            lambda state: car_line(state, without.seconds), Console())
        display.say(f'{namespace}/{car_space(car)}; logs in {folder}')
        interrupted = run_to_the_end(
            graph, namespace=arguments.namespace, folder=folder, monitor=monitor,
            display=display, over=lambda: without.look() > arguments.wait)
    finally:
        monitor.close()
    if interrupted:
        return INTERRUPTED
    display.say(f'the trainer has been gone for {arguments.wait:g} s: this car ends')
    return 0


class Absence:
    """
    How long something has not been there.

    Attributes:
        seconds: at the last look.
    """

    def __init__(self, there: Callable[[], bool]) -> None:
        """Begin with something that is there."""
        self._there = there
        self._seen_at = time.monotonic()
        self.seconds = 0.0

    def look(self) -> float:
        """Look for it, and return the seconds without it."""
        now = time.monotonic()
        if self._there():
            self._seen_at = now
        self.seconds = now - self._seen_at
        return self.seconds


def car_line(state: GraphState, without: float = 0.0) -> str:
    """Return what one car does as one plain line; `without`: seconds without a trainer."""
    rate = state.value(SIMULATOR.name, 'decisions_per_second', 0.0)
    version = state.value(POLICY.name, 'weights_version', 0.0)
    line = (f'{state.summary(SIMULATOR.name)}, {rate:.0f} decisions/s, epsilon '
            f'{state.value(POLICY.name, "epsilon", 1.0):.3f}, weights version {version:.0f}')
    if without > GONE_SECONDS:
        line = f'NO TRAINER for {without:.0f} s, {line}'
    if state.episodes:
        line += f', {state.ended} episodes, return {state.episodes[-1]["episode_return"]:.1f}'
    return line


def car_table(state: GraphState, rows: int, without: float = 0.0) -> Table:
    """Return the same for a terminal, in fewer than `rows` lines."""
    table = Table(title=Text(state.namespace), show_header=False)
    table.add_column()
    for part in car_line(state, without).split(', ')[:rows - 4]:
        table.add_row(Text(part))
    return table
