# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing run`: simulator, policy and recorder; laps with progress and a bag at the end."""
from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.graph import driving_graph, Graph, SIMULATOR
from carracing_dqn.bringup.models import action_repeat, as_parameter, choose_model, identity
from carracing_dqn.bringup.monitor import absolute_namespace, GraphState, Monitor
from carracing_dqn.bringup.provenance import with_provenance
from carracing_dqn.bringup.run_folders import default_folder, new_folder, shell_word
from carracing_dqn.bringup.supervise import check_machine, refuse_second_simulator, run_to_the_end
from carracing_dqn.bringup.vehicle import vehicle_of
from carracing_dqn.simulation.profiles import seen_from
from carracing_dqn.simulation.registry import CARRACING, frame_seconds
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.plain_text import plain
from rich.console import Console
from rich.table import Table
from rich.text import Text

TABLE_FRAME = 9
"""Lines of the terminal that are no laps: title, header, frame, sum, prompt."""
# of what the simulator says before it drives
WIDTH = 80


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing run`."""
    parser.add_argument('--model', default=None,
                        help='model folder, name of a shipped model, or random '
                             '(default: the best that is shipped)')
    parser.add_argument('--simulator', default='carracing', metavar='NAME|PROFILE|MODULE:CLASS',
                        help='what to drive in (default: %(default)s)')
    parser.add_argument('--laps', type=int, default=3,
                        help='episodes to drive; 0 = until Ctrl-C (default 3)')
    parser.add_argument('--seed', type=int, default=420,
                        help='seed of the first track; the next ones count up (default 420)')
    parser.add_argument('--real-time', action='store_true',
                        help='50 frames a second of wall time instead of lockstep')
    parser.add_argument('--output', type=Path, default=None,
                        help='folder for the bag and the logs (default: runs/drive-<time>)')
    parser.add_argument('--no-bag', action='store_true', help='record nothing')
    parser.add_argument('--namespace', default='', help='ROS namespace of the nodes')


def main(arguments: argparse.Namespace) -> int:
    """Drive laps until they are done or the user stops them; return the exit code."""
    if arguments.laps < 0:
        raise BridgeError(f'--laps is {arguments.laps}; accepted: 0 (endless) or more')
    if not 0 <= arguments.seed < 2**31:
        raise BridgeError(f'--seed is {arguments.seed}; accepted: 0 to {2**31 - 1}')
    absolute_namespace(arguments.namespace)
    check_machine()
    model = choose_model(arguments.model)
    repeat = action_repeat(model, frame_seconds(arguments.simulator))
    vehicle = vehicle_of(arguments.simulator)
    monitor = Monitor(arguments.namespace)
    try:
        refuse_second_simulator(monitor)
        folder = new_folder(arguments.output or default_folder('drive'))
        display = Display(monitor.state, laps_table, laps_line, Console())
        display.say(f'model {as_parameter(model, ".")}; output {folder}')
        interrupted = run_to_the_end(
            _graph(arguments, model, repeat, folder, vehicle), namespace=arguments.namespace,
            folder=folder, monitor=monitor, display=display,
            settled=lambda: monitor.state.ended >= arguments.laps)
    finally:
        monitor.close()
    bag = folder / 'bag'
    if bag.is_dir():
        display.say(f'bag: {bag}  (look: carracing bag info {shell_word(bag)})')
        # who stops it from elsewhere wants its end at once
        wanted = not interrupted or display.on_terminal
        if wanted and monitor.state.ended and arguments.simulator in CARRACING:
            _draw(bag, folder / 'pictures', display, hint=interrupted)
    return INTERRUPTED if interrupted else 0


def _draw(bag: Path, folder: Path, display: Display, *, hint: bool) -> None:
    """Draw the laps of a bag until all are drawn or Ctrl-C ends it."""
    from carracing_dqn.bringup.run_pictures import draw_recorded_laps
    if hint:
        display.say('drawing the laps; Ctrl-C ends that, too')
    try:
        for picture in draw_recorded_laps(bag, folder):
            display.say(f'picture: {picture}')
    except BridgeError as error:
        # the drive was good, and the bag is there
        display.say(f'no pictures: {error}')


def _graph(
    arguments: argparse.Namespace, model: str, repeat: int, folder: Path,
    vehicle: Mapping[str, Any],
) -> Graph:
    graph = driving_graph(
        model=as_parameter(model, folder), seed=arguments.seed,
        simulator=seen_from(arguments.simulator, folder), episodes=arguments.laps,
        policy=vehicle,
        stepping='real_time' if arguments.real_time else 'lockstep',
        # in real time every frame is shown; in lockstep only those the policy decides on
        action_repeat=1 if arguments.real_time else repeat,
        bag=None if arguments.no_bag else 'bag')
    return with_provenance(graph, model=identity(model))


def laps_table(state: GraphState, rows: int) -> Table:
    """Return the newest laps as a table that fits into some rows."""
    rate = state.value(SIMULATOR.name, 'decisions_per_second', 0.0)
    title = (f'{rate:.0f} decisions a second' if rate or state.ended
             else state.summary(SIMULATOR.name))
    laps = list(state.episodes)[-max(1, rows - TABLE_FRAME):]
    if state.ended > len(laps):
        title += f'; the last of {state.ended} laps, mean return {state.mean_return:.1f}'
    table = Table(title=Text(plain(title, WIDTH)))
    for column in ('track', 'return', 'frames', 'tiles', 'end'):
        table.add_column(column, justify='right')
    for lap in laps:
        table.add_row(
            f'{lap["seed"]:.0f}', f'{lap["episode_return"]:.1f}', lap_frames(lap),
            f'{lap["tiles_visited"]:.0f}/{lap["tiles_total"]:.0f}'
            if {'tiles_visited', 'tiles_total'} <= lap.keys() else '-', lap_end(lap))
    return table


def lap_frames(lap: dict[str, float]) -> str:
    """Return how many simulated frames an episode took; not every simulator says so."""
    return f'{lap["step"]:.0f}' if 'step' in lap else '-'


def lap_end(lap: dict[str, float]) -> str:
    """Return how an episode ended, in words."""
    for name in ('lap_finished', 'left_field', 'ended_early'):
        if lap.get(name):
            return name.replace('_', ' ').replace('left', 'left the')
    return 'ended' if lap['terminated'] else 'time over'


def laps_line(state: GraphState) -> str:
    """Return the state as one plain line."""
    if not state.episodes:
        return f'driving: {state.summary(SIMULATOR.name)}'
    lap = state.episodes[-1]
    return (f'{state.ended} lap{"s" if state.ended > 1 else ""}, mean return '
            f'{state.mean_return:.1f}; last: {lap["episode_return"]:.1f} in '
            f'{lap_frames(lap)} frames, {lap_end(lap)}')
