# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing train`: trainer, simulator, policy and validator; learns until it is stopped."""
from __future__ import annotations

import argparse
from pathlib import Path
import time

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.monitor import GraphState, Monitor
from carracing_dqn.bringup.processes import node_command, ProcessGroup
from carracing_dqn.bringup.provenance import provenance_text
from carracing_dqn.bringup.run_command import (
    default_folder, new_folder, refuse_second_simulator, stop_on_signals,
)
from msgs_bridge.errors import BridgeError
from rich.console import Console
from rich.table import Table
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.open_run import read_overrides, resume_point, run_settings
from trainer_node.run_folder import RunFolder

TRAINER = 'trainer_node'
SIMULATOR = 'carracing_sim_node'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing train`."""
    parser.add_argument('--preset', default='racing',
                        help='racing, report, or the path of a YAML file (default racing)')
    parser.add_argument('--run', type=Path, default=None,
                        help='run folder (default: runs/<preset>-<time>)')
    parser.add_argument('--resume', type=Path, default=None, metavar='RUN',
                        help='go on with a run folder')
    parser.add_argument('--minutes', type=float, default=None,
                        help="wall time of the whole run; the preset's own by default")
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE',
                        help='another value for a hyperparameter; may be given several times')
    parser.add_argument('--bag', action='store_true', help='record every topic into RUN/bag')
    parser.add_argument('--from-bag', nargs='+', type=Path, default=None, metavar='BAG',
                        help='learn from the transitions in bags instead of driving')
    parser.add_argument('--tensorboard', action='store_true',
                        help='write TensorBoard event files into RUN/tensorboard')
    parser.add_argument('--namespace', default='', help='ROS namespace of the nodes')


def main(arguments: argparse.Namespace) -> int:
    """Train until the run is complete or the user stops it; return the exit code."""
    console = Console()
    stop_on_signals()
    overrides = list(arguments.set)
    if arguments.minutes is not None:
        overrides.append(f'run_minutes={arguments.minutes}')
    resume = arguments.resume is not None
    folder = arguments.resume if resume else arguments.run or default_folder(
        Path(arguments.preset).stem)
    if not resume and folder.exists() and not RunFolder(folder).unfinished_start:
        raise BridgeError(f'{folder} exists already; choose another folder')
    if arguments.from_bag:
        from carracing_dqn.bringup.train_from_bag import learn_from_bags
        return learn_from_bags(
            arguments.from_bag, folder, arguments.preset, read_overrides(overrides), console,
            namespace=arguments.namespace, resume=resume, tensorboard=arguments.tensorboard)
    # before the folder is made, so that a wrong name leaves nothing behind
    hyperparameters = run_settings(
        folder, arguments.preset, read_overrides(overrides), resume=resume)
    episodes = 0
    if resume:
        episodes = resume_point(folder, hyperparameters)
    elif not folder.exists():
        new_folder(folder)
    (folder / 'log').mkdir(exist_ok=True)
    monitor = Monitor(arguments.namespace)
    try:
        refuse_second_simulator(monitor)
        console.print(f'run folder {folder}', highlight=False, soft_wrap=True)
        interrupted = train(
            arguments, hyperparameters, episodes, overrides, folder, monitor, console)
    finally:
        monitor.close()
    run = RunFolder(folder)
    for name, path in (('best', run.best), ('final', run.final)):
        if path.is_dir():
            console.print(f'{name} model: {path}', highlight=False, soft_wrap=True)
    if interrupted:
        console.print(f'go on with: carracing train --resume {folder}', highlight=False,
                      soft_wrap=True)
    return 130 if interrupted else 0


def train(
    arguments: argparse.Namespace, hyperparameters: Hyperparameters, episodes: int,
    overrides: list[str], folder: Path, monitor: Monitor, console: Console,
) -> bool:
    """Run the graph until the trainer is done; return whether the user stopped it."""
    space = arguments.namespace
    simulator = {
        **hyperparameters.simulator_parameters(),
        'first_episode': episodes,
        'wait_for_subscribers': 2 if arguments.bag else 1,
    }
    # the simulator listens to the policy, too
    policy = {'model': '', 'explore': True, 'seed': hyperparameters.seed,
              'wait_for_subscribers': 1 + simulator['wait_for_subscribers']}
    trainer = {
        'run': str(folder), 'resume': arguments.resume is not None,
        'preset': arguments.preset, 'overrides': ','.join(overrides),
        'tensorboard': arguments.tensorboard,
    }
    validator = {'seed': hyperparameters.validation_seed,
                 'tracks': hyperparameters.validation_tracks}
    with ProcessGroup(folder / 'log') as group:
        if arguments.bag:
            group.start('recorder', node_command('bags.recorder_node', {
                'folder': str(next_bag(folder)),
                'provenance': provenance_text(
                    simulator=simulator, policy=policy, trainer=trainer)}, space))
        group.start('trainer', node_command('trainer_node', trainer, space))
        group.start('policy', node_command('dqn_policy_node', policy, space))
        # validation takes the time the others leave
        group.start('validator', node_command(
            'carracing_dqn.evaluation.node', validator, space), nice=5)
        group.start('simulator', node_command('carracing_sim_node', simulator, space))
        try:
            with Display(monitor.state, training_table, training_line, console) as display:
                while group.check() is None:
                    display.update()
                    time.sleep(0.1)
        except KeyboardInterrupt:
            console.print('stopping', highlight=False)
            return True
        finally:
            killed = group.stop()
            if killed:
                console.print(f'killed, because they did not stop in time: {", ".join(killed)}',
                              highlight=False)
    return False


def next_bag(folder: Path) -> Path:
    """Return a bag folder that does not exist yet: bag, then bag-1, bag-2 after resumes."""
    path, number = folder / 'bag', 0
    while path.exists():
        number += 1
        path = folder / f'bag-{number}'
    return path


LIVE_VALUES = (
    ('return, last episode', 'last_return', '.1f'),
    ('return, moving average', 'mean_return', '.1f'),
    ('episodes', 'episodes', '.0f'),
    ('decisions', 'decisions', '.0f'),
    ('updates', 'updates', '.0f'),
    ('epsilon', 'epsilon', '.3f'),
    ('learning rate', 'learning_rate', '.2e'),
    ('updates/s', 'updates_per_second', '.1f'),
    ('samples per transition', 'replay_ratio', '.2f'),
    ('replay', 'replay_size', '.0f'),
    ('TD error', 'td_error', '.3f'),
    ('mean Q', 'q_mean', '.2f'),
    ('weights version', 'weights_version', '.0f'),
    ('share of the run done', 'progress', '.1%'),
)
"""Label, name in the trainer's diagnostics and format of what the display shows."""


def training_table(state: GraphState) -> Table:
    """Return the state of learning as a table."""
    table = Table(title=state.health.get(TRAINER, {}).get('summary', 'starting'))
    table.add_column('')
    table.add_column('', justify='right')
    for label, name, form in LIVE_VALUES:
        value = state.value(TRAINER, name)
        table.add_row(label, '-' if value != value else format(value, form))
    seconds, progress = state.value(TRAINER, 'wall_seconds'), state.value(TRAINER, 'progress')
    if progress > 0:
        table.add_row('minutes so far', f'{seconds / 60:.1f}')
        table.add_row('minutes left, about', f'{seconds * (1 / progress - 1) / 60:.1f}')
    table.add_row('decisions/s', f'{state.value(SIMULATOR, "decisions_per_second", 0.0):.0f}')
    age = (state.value(TRAINER, 'weights_version')
           - state.value('dqn_policy_node', 'weights_version'))
    table.add_row('weight age (versions)', '-' if age != age else f'{age:.0f}')
    for result in list(state.validations)[-3:]:
        table.add_row(f'validation of version {result["version"]:.0f}',
                      f'{result["mean"]:.1f} ± {result["std"]:.1f}, '
                      f'{result["completed"]:.0%} completed')
    return table


def training_line(state: GraphState) -> str:
    """Return the state of learning as one plain line."""
    def show(name: str, form: str) -> str:
        return format(state.value(TRAINER, name, 0.0), form)

    minutes = state.value(TRAINER, 'wall_seconds', 0.0) / 60
    line = (f"{minutes:.1f} min: episode {show('episodes', '.0f')}, "
            f'return {show("last_return", ".1f")}, average {show("mean_return", ".1f")}, '
            f'epsilon {show("epsilon", ".3f")}, {show("updates_per_second", ".1f")} updates/s, '
            f'{state.value(SIMULATOR, "decisions_per_second", 0.0):.0f} decisions/s')
    if state.validations:
        result = state.validations[-1]
        line += f'; validation {result["mean"]:.1f} ± {result["std"]:.1f}'
    return line
