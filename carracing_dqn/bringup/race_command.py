# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing race`: a person drives the tracks of a model, in a window, recorded like a policy."""
from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator
import dataclasses
import math
from pathlib import Path
from typing import Any

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.graph import RACE, race_graph
from carracing_dqn.bringup.monitor import absolute_namespace, GraphState, Monitor
from carracing_dqn.bringup.provenance import with_provenance
from carracing_dqn.bringup.run_command import laps_line, laps_table
from carracing_dqn.bringup.run_folders import default_folder, new_folder, shell_word
from carracing_dqn.bringup.supervise import check_machine, refuse_second_simulator, run_to_the_end
from carracing_dqn.evaluation.evaluate_command import DEFAULT_MODEL
from carracing_dqn.evaluation.laps import drive_lap, Lap, lap_of, MAX_FRAMES
from carracing_dqn.evaluation.policies import model_source, PolicySource
from carracing_dqn.evaluation.progress import LapProgress
from carracing_dqn.evaluation.results import Results, write_json
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import make_simulator
from carracing_dqn.simulation.registry import DEFAULT
from carracing_dqn.teleop.rivals import Rival, write_rivals
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.machine import describe_machine
from msgs_bridge.simulator import Simulator
from rich.console import Console
from rich.table import Table
from rich.text import Text

PERSON = 'person'
MOST_LAPS = 100
RIVALS = 'rivals.json'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing race`."""
    parser.add_argument('--model', default=DEFAULT_MODEL, metavar='DIR|NAME',
                        help='who is raced against: model folder, run folder or name of a '
                             'shipped model (default: %(default)s)')
    parser.add_argument('--laps', type=int, default=3,
                        help='laps, each on a track of its own (default: %(default)s)')
    parser.add_argument('--seed', type=int, default=420,
                        help='seed of the first track; the next ones count up '
                             '(default: %(default)s)')
    parser.add_argument('--speed', type=float, default=1.0, metavar='FACTOR',
                        help='how fast time goes; 0.5 is easier (default: %(default)s)')
    parser.add_argument('--scale', type=int, default=6, metavar='N',
                        help='size of a pixel of the picture (default: %(default)s)')
    parser.add_argument('--output', type=Path, default=None,
                        help='folder for laps, bag and logs (default: runs/race-<time>)')
    parser.add_argument('--no-bag', action='store_true', help='record nothing')
    parser.add_argument('--namespace', default='', help='ROS namespace of the nodes')
    parser.epilog = ('In the window: arrows or W A S D, or a joystick. A lap begins with gas; '
                     'Escape ends, and what was driven counts.')


def main(arguments: argparse.Namespace) -> int:
    """Race until the laps are done or the person has had enough; return the exit code."""
    _check(arguments)
    absolute_namespace(arguments.namespace)
    # pygame greets on standard output unless gymnasium was imported before it
    from carracing_dqn.teleop.race_window import check_screen
    check_screen()
    check_machine()
    source = model_source(arguments.model)
    identity = source.identity()
    console = Console()
    monitor = Monitor(arguments.namespace)
    try:
        refuse_second_simulator(monitor)
        folder = new_folder(arguments.output or default_folder('race'))
        display = Display(monitor.state, laps_table, laps_line, console)
        display.say(f'{source.name} drives first; output {folder}')
        model = Results(identity, DEFAULT, wanted=arguments.laps, machine=describe_machine())
        rivals = _drive_model(source, arguments, model, console)
        write_rivals(folder / RIVALS, source.name, rivals)
        write_json(folder / 'model.json', model)
        display.say('your turn: the window takes arrows or W A S D; Escape ends')
        interrupted = run_to_the_end(
            with_provenance(race_graph(
                seed=arguments.seed, episodes=arguments.laps,
                race={'rivals': RIVALS, 'scale': arguments.scale,
                      'real_time_factor': arguments.speed},
                bag=None if arguments.no_bag else 'bag'), rivals=identity),
            namespace=arguments.namespace, folder=folder, monitor=monitor, display=display,
            settled=lambda: (monitor.state.ended >= arguments.laps
                             or monitor.state.value(RACE.name, 'leaving', 0.0) > 0))
    finally:
        monitor.close()
    person = Results(
        {'kind': PERSON, 'name': PERSON, 'speed': arguments.speed}, 'graph',
        laps=person_laps(monitor.state, model.laps), wanted=arguments.laps,
        machine=describe_machine())
    if person.laps:
        write_json(folder / 'person.json', person)
        console.print(race_table(person, model, source.name))
        display.say(f'wrote {folder / "person.json"} and {folder / "model.json"}')
    else:
        display.say('no lap was begun')
    bag = folder / 'bag'
    if bag.is_dir():
        display.say(f'bag: {bag}  (learn from it: carracing train --demonstrations '
                    f'{shell_word(bag)})')
    return INTERRUPTED if interrupted else 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise BridgeError for options that cannot be, before anything is made."""
    for name, low, high in (('laps', 1, MOST_LAPS), ('seed', 0, 2**31 - 1 - MOST_LAPS),
                            ('speed', 0.05, 10), ('scale', 1, 20)):
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise BridgeError(f'--{name} is {value}; accepted: {low} to {high}')


def _drive_model(
    source: PolicySource, arguments: argparse.Namespace, results: Results, console: Console,
) -> list[Rival]:
    """Drive the laps of the model into `results`, and return them frame by frame."""
    limit_torch_threads()
    simulator = make_simulator(DEFAULT)
    policy = source.open(simulator.frame_seconds)
    rivals = []
    with LapProgress([], arguments.laps, console) as progress:
        for seed in range(arguments.seed, arguments.seed + arguments.laps):
            lap, rival = _drive_rival(simulator, policy, seed)
            results.laps[seed] = lap
            rivals.append(rival)
            progress.add(lap)
    return rivals


def _drive_rival(simulator: Simulator, policy: Any, seed: int) -> tuple[Lap, Rival]:
    """Drive one lap and keep it frame by frame."""
    returns, tiles = [0.0], [0]

    def watch(world: Any, reward: float) -> None:
        returns.append(returns[-1] + reward)
        tiles.append(world.tile_visited_count)

    lap = drive_lap(simulator, policy, seed, watch=watch)
    return lap, Rival(seed, returns, tiles, bool(lap.lap_finished))


def person_laps(state: GraphState, seeds: Collection[int]) -> dict[int, Lap]:
    """
    Return the laps that were driven by seed, the one that was left with what it had.

    Args:
        state: of the graph, in which anybody may say anything.
        seeds: of the tracks of the race; of others nothing is taken.
    """
    names = ('seed', 'episode_return', 'step', 'tiles_visited', 'tiles_total')
    # NaN where no lap was under way
    left = {**{name: state.value(RACE.name, name) for name in names}, 'lap_finished': 0.0}
    laps: dict[int, Lap] = {}
    for summary in (*state.episodes, left):
        seed, frames = summary['seed'], summary.get('step', 0.0)
        if seed in seeds and seed not in laps and 1 <= frames <= MAX_FRAMES and (
                math.isfinite(summary['episode_return'])):
            laps[int(seed)] = lap_of(
                int(seed), summary['episode_return'], int(frames), summary, 0.0)
    return laps


def race_table(person: Results, model: Results, name: str) -> Table:
    """Return both by track, and their means over the tracks that both have driven."""
    table = Table(title=Text(f'you and {name}'), title_justify='left')
    table.add_column('track', justify='right')
    for who in ('you', name):
        for column in ('return', 'frames', 'end'):
            table.add_column(Text(f'{who}\n{column}'), justify='right')
    for seed, lap in sorted(person.laps.items()):
        table.add_row(f'{seed}', *_cells(lap), *_cells(model.laps[seed]))
    if len(person.laps) > 1:
        both = dataclasses.replace(
            model, laps={seed: model.laps[seed] for seed in person.laps})
        table.add_section()
        table.add_row('mean', *(cell for results in (person, both) for cell in (
            f'{results.statistics.mean:.1f}', f'{results.statistics.frames:.0f}', '')))
    return table


def _cells(lap: Lap) -> Iterator[str]:
    """Yield return, frames and how a lap ended."""
    yield f'{lap.episode_return:.1f}'
    yield f'{lap.frames}'
    yield ('lap finished' if lap.lap_finished else 'left the field' if lap.left_field
           else 'time over' if lap.left_field is not None else 'given up')
