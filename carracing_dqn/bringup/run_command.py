# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing run`: simulator, policy and recorder; laps with progress and a bag at the end."""
from __future__ import annotations

import argparse
import math
from pathlib import Path
import signal
import time

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.models import action_repeat, choose_model
from carracing_dqn.bringup.monitor import GraphState, Monitor
from carracing_dqn.bringup.processes import node_command, ProcessGroup
from carracing_dqn.bringup.provenance import provenance_text
from msgs_bridge.errors import BridgeError
from rich.console import Console
from rich.table import Table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing run`."""
    parser.add_argument('--model', default=None,
                        help='model folder, name of a shipped model, or random '
                             '(default: the best that is shipped)')
    parser.add_argument('--laps', type=int, default=3, help='episodes to drive (default 3)')
    parser.add_argument('--seed', type=int, default=420,
                        help='seed of the first track; the next ones count up (default 420)')
    parser.add_argument('--real-time', action='store_true',
                        help='50 frames a second of wall time instead of lockstep')
    parser.add_argument('--output', type=Path, default=None,
                        help='folder for the bag and the logs (default: runs/drive-<time>)')
    parser.add_argument('--no-bag', action='store_true', help='record nothing')
    parser.add_argument('--namespace', default='', help='ROS namespace of the nodes')


def stop_on_signals() -> None:
    """Make SIGTERM end a command as Ctrl-C does."""
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGINT, interrupt)


def refuse_second_simulator(monitor: Monitor) -> None:
    """
    Look for a simulator that runs already: two would both answer to the same twists.

    Raises:
        BridgeError: there is one.
    """
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        if monitor.simulators():
            raise BridgeError(
                'a simulator runs on this ROS domain already; stop it, or use --namespace or '
                'another ROS_DOMAIN_ID')
        time.sleep(0.1)


def default_folder(prefix: str) -> Path:
    """Return the output folder of a run for which none was named."""
    return Path('runs') / f'{prefix}-{time.strftime("%Y%m%d-%H%M%S")}'


def new_folder(path: Path) -> Path:
    """
    Make the output folder of a run and return it.

    Raises:
        BridgeError: it exists already or cannot be made.
    """
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        raise BridgeError(f'{path} exists already; choose another folder') from None
    except OSError as error:
        raise BridgeError(f'{path} cannot be made: {error.strerror}') from None
    (path / 'log').mkdir()
    return path


def laps_table(state: GraphState) -> Table:
    """Return the laps so far as a table."""
    table = Table(title=f'{state.value("carracing_sim_node", "decisions_per_second", 0.0):.0f} '
                        'decisions a second')
    for column in ('track', 'return', 'frames', 'tiles', 'end'):
        table.add_column(column, justify='right')
    for lap in state.episodes:
        table.add_row(
            f'{lap["seed"]:.0f}', f'{lap["episode_return"]:.1f}', f'{lap["step"]:.0f}',
            f'{lap["tiles_visited"]:.0f}/{lap["tiles_total"]:.0f}'
            if 'tiles_total' in lap else '-', lap_end(lap))
    return table


def lap_end(lap: dict[str, float]) -> str:
    """Return how an episode ended, in words."""
    for name in ('lap_finished', 'left_field', 'ended_early'):
        if lap.get(name):
            return name.replace('_', ' ').replace('left', 'left the')
    return 'ended' if lap['terminated'] else 'time over'


def laps_line(state: GraphState) -> str:
    """Return the state as one plain line."""
    if not state.episodes:
        return 'driving: ' + state.health.get('carracing_sim_node', {}).get('summary', 'starting')
    lap = state.episodes[-1]
    laps = f'{len(state.episodes)} lap{"s" if len(state.episodes) > 1 else ""}'
    return (f'{laps}, mean return '
            f'{mean_return(state):.1f}; last: {lap["episode_return"]:.1f} in '
            f'{lap["step"]:.0f} frames, {lap_end(lap)}')


def mean_return(state: GraphState) -> float:
    """Return the mean return of all laps; NaN without any."""
    returns = [lap['episode_return'] for lap in state.episodes]
    return sum(returns) / len(returns) if returns else math.nan


def main(arguments: argparse.Namespace) -> int:
    """Drive laps until they are done or the user stops them; return the exit code."""
    if arguments.laps < 0:
        raise BridgeError(f'--laps is {arguments.laps}; accepted: 0 (endless) or more')
    if not 0 <= arguments.seed < 2**31:
        raise BridgeError(f'--seed is {arguments.seed}; accepted: 0 to {2**31 - 1}')
    console = Console()
    stop_on_signals()
    model = choose_model(arguments.model)
    monitor = Monitor(arguments.namespace)
    try:
        refuse_second_simulator(monitor)
        folder = new_folder(arguments.output or default_folder('drive'))
        console.print(f'model {model}; output {folder}', highlight=False, soft_wrap=True)
        interrupted = drive(arguments, model, folder, monitor, console)
    finally:
        monitor.close()
    bag = folder / 'bag'
    if bag.is_dir():
        console.print(f'bag: {bag}  (look: carracing bag info {bag})', highlight=False,
                      soft_wrap=True)
        if not interrupted:
            from carracing_dqn.bringup.run_pictures import draw_recorded_laps
            for picture in draw_recorded_laps(bag, folder / 'pictures'):
                console.print(f'picture: {picture}', highlight=False, soft_wrap=True)
    return 130 if interrupted else 0


def drive(
    arguments: argparse.Namespace, model: str, folder: Path, monitor: Monitor, console: Console,
) -> bool:
    """Run the nodes until the simulator has driven its laps; return whether it was stopped."""
    simulator = {
        'seed': arguments.seed, 'seed_each_episode': True, 'episodes': arguments.laps,
        'stepping': 'real_time' if arguments.real_time else 'lockstep',
        # in real time every frame is shown; in lockstep only those the policy decides on
        'action_repeat': 1 if arguments.real_time else action_repeat(model),
        'wait_for_subscribers': 0 if arguments.no_bag else 1,
    }
    # the simulator listens to the policy, too
    policy = {'model': model, 'wait_for_subscribers': 1 + simulator['wait_for_subscribers']}
    space = arguments.namespace
    with ProcessGroup(folder / 'log') as group:
        if not arguments.no_bag:
            group.start('recorder', node_command(
                'bags.recorder_node', {
                    'folder': str(folder / 'bag'),
                    'provenance': provenance_text(simulator=simulator, policy=policy),
                }, space))
        group.start('policy', node_command('dqn_policy_node', policy, space))
        group.start('simulator', node_command(
            'carracing_sim_node', simulator, space))
        try:
            with Display(monitor.state, laps_table, laps_line, console) as display:
                while group.check() is None:
                    display.update()
                    time.sleep(0.1)
                wait_for_episodes(monitor, arguments.laps)
        except KeyboardInterrupt:
            console.print('stopping', highlight=False)
            return True
        finally:
            group.stop()
        if not console.is_terminal:
            console.print(laps_line(monitor.state), highlight=False)
    return False


def wait_for_episodes(monitor: Monitor, episodes: int) -> None:
    """Give the last summaries a moment to arrive."""
    deadline = time.monotonic() + 1.0
    while len(monitor.state.episodes) < episodes and time.monotonic() < deadline:
        time.sleep(0.05)
