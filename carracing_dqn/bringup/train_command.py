# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing train`: trainer, simulator, policy and validator; learns until it is stopped."""
from __future__ import annotations

import argparse
from collections.abc import Mapping
import importlib.util
import os
from pathlib import Path
import shutil
import textwrap
from typing import Any

from carracing_dqn.bringup.curve import past_returns
from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.graph import (
    car_space, cars_graph, Graph, learner_graph, training_graph,
)
from carracing_dqn.bringup.monitor import absolute_namespace, Monitor
from carracing_dqn.bringup.provenance import with_provenance
from carracing_dqn.bringup.recipe import pairs_of_model, pairs_of_simulator
from carracing_dqn.bringup.run_folders import default_folder, new_folder, shell_word
from carracing_dqn.bringup.supervise import check_machine, refuse_second_simulator, run_to_the_end
from carracing_dqn.bringup.training_display import model_lines, training_line, training_table
from carracing_dqn.bringup.vehicle import vehicle_of
from carracing_dqn.simulation import find_simulator
from carracing_dqn.simulation.profiles import found_from
from carracing_dqn.studies.simulator_settings import choose_preset, PRESET, SIMULATOR_PRESET
from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.exit_codes import INTERRUPTED
from msgs_bridge.plain_text import plain
from msgs_bridge.seeds import MAX_CARS
from msgs_bridge.settings import describe
from msgs_bridge.terminal import say
from rich.console import Console
from trainer_node.hyperparameters import Hyperparameters, load_preset, preset_names
from trainer_node.open_run import read_overrides, resume_point, ResumePoint, run_settings
from trainer_node.run_folder import RunFolder
from trainer_node.settings import MOVING_AVERAGE_EPISODES

DEMONSTRATIONS = 'demonstrations.safetensors'
"""File in the run folder."""

LIST_HINT = 'carracing train --list prints every name and what it accepts'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing train`."""
    parser.add_argument('--preset', default=None,
                        help=f'{", ".join(preset_names())}, or the path of a YAML file (default '
                             f'{PRESET}; with --simulator {SIMULATOR_PRESET})')
    parser.add_argument('--simulator', default=None, metavar='NAME|PROFILE|MODULE:CLASS',
                        help='what to learn in: its frames, and what its profile says of a '
                             'preset and hyperparameters')
    parser.add_argument('--initial-model', default=None, metavar='MODEL',
                        help='begin with the weights of a model, and take its network, stack and '
                             'actions')
    parser.add_argument('--run', type=Path, default=None,
                        help='run folder (default: runs/<preset>-<time>)')
    parser.add_argument('--resume', type=Path, default=None, metavar='RUN',
                        help='go on with a run folder')
    parser.add_argument('--minutes', type=float, default=None,
                        help="wall time of the whole run; the preset's own by default")
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE',
                        help='another value for a hyperparameter; may be given several times')
    parser.add_argument('--list', action='store_true',
                        help='print the hyperparameters with their values in the preset, what '
                             'they accept and mean, and end')
    parser.add_argument('--cars', type=int, default=0, metavar='N',
                        help='learn from N cars at once, each in a namespace of its own; more '
                             'may join')
    parser.add_argument('--role', choices=('learner',), default=None,
                        help='learner: trainer and validator alone, for cars that join by '
                             'carracing drive --join, here or on other hosts')
    parser.add_argument('--bag', action='store_true', help='record every topic into RUN/bag')
    parser.add_argument('--from-bag', nargs='+', type=Path, default=None, metavar='BAG',
                        help='learn from the transitions in bags instead of driving')
    parser.add_argument('--demonstrations', nargs='+', type=Path, default=None, metavar='BAG',
                        help='begin with what somebody drove in bags, a person or a model: learn '
                             'from it first, and keep it for good (docs/learning.md)')
    parser.add_argument('--tensorboard', action='store_true',
                        help='write TensorBoard event files into RUN/tensorboard')
    parser.add_argument('--namespace', default='', help='ROS namespace of the nodes')


def main(arguments: argparse.Namespace) -> int:
    """Train until the run is complete or the user stops it; return the exit code."""
    _check(arguments)
    console = Console()
    resume = arguments.resume is not None
    preset = choose_preset(arguments.preset, arguments.simulator)
    folder = arguments.resume or arguments.run or default_folder(
        Path(arguments.simulator or preset).stem.replace(':', '.'))
    # before the folder is made, so that a wrong name leaves nothing behind
    arguments.pairs = _pairs(arguments, preset, folder)
    overrides = _overrides(arguments.pairs)
    hyperparameters = run_settings(arguments.resume, preset, overrides, resume=resume)
    if arguments.list:
        for line in hyperparameter_lines(hyperparameters, shutil.get_terminal_size().columns):
            say(console, line)
        return 0
    # one that was killed before its first checkpoint is begun anew
    begun = resume or RunFolder(folder).unfinished_start
    if folder.exists() and not begun:
        raise BridgeError(f'{folder} exists already; choose another folder'
                          f'{_what_next(folder, ", or ")}')
    if arguments.from_bag:
        from carracing_dqn.bringup.train_from_bag import learn_from_bags
        return learn_from_bags(
            arguments.from_bag, folder, preset, overrides, console,
            namespace=arguments.namespace, resume=resume, tensorboard=arguments.tensorboard)
    simulator = found_from(hyperparameters.simulator, folder)
    find_simulator(simulator)
    vehicle = vehicle_of(simulator)
    shown = None
    if arguments.demonstrations:
        from carracing_dqn.bringup.demonstrations import demonstrations_from
        shown = demonstrations_from(
            arguments.demonstrations, hyperparameters, arguments.namespace)
        say(console, f'demonstrations: {shown.summary}')
    done = resume_point(folder, hyperparameters) if resume else ResumePoint()
    check_machine()
    monitor = Monitor(arguments.namespace)
    try:
        refuse_second_simulator(monitor, tuple(map(car_space, range(arguments.cars))))
        new_folder(folder, begun=begun)
        for point in past_returns(
                RunFolder(folder).episodes, done.episodes, MOVING_AVERAGE_EPISODES):
            monitor.state.curve.add(*point)
        if shown is not None:
            shown.write(folder / DEMONSTRATIONS)
        display = Display(monitor.state, training_table, training_line, console)
        display.say(f'run folder {folder}')
        if not resume and load_preset(preset, overrides).bf16 != hyperparameters.bf16:
            display.say('this processor has no bfloat16: learning in float32, which is faster')
        interrupted = run_to_the_end(
            _graph(arguments, hyperparameters, folder, done, vehicle),
            namespace=arguments.namespace, folder=folder, monitor=monitor, display=display)
    except BridgeError as error:
        raise BridgeError(f'{error}{_what_next(folder, "; ")}') from None
    finally:
        monitor.close()
    for line in model_lines(folder):
        display.say(line)
    if interrupted:
        display.say(_what_next(folder) or 'nothing was learned yet')
    return INTERRUPTED if interrupted else 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise BridgeError for options that cannot be, before anything is made."""
    absolute_namespace(arguments.namespace)
    if arguments.minutes is not None and not 0 < arguments.minutes <= 1e6:
        raise BridgeError(f'--minutes is {arguments.minutes:g}; accepted: above 0, up to 1000000')
    if arguments.resume is not None and (
            arguments.run or arguments.preset or arguments.simulator
            or arguments.initial_model or arguments.demonstrations):
        raise BridgeError('--resume goes on in its own folder with its own settings: --run, '
                          '--preset, --simulator, --initial-model, --demonstrations are for a '
                          'new run; --set changes single values')
    if arguments.demonstrations and arguments.from_bag:
        raise BridgeError('--demonstrations is a beginning for a run that drives, and --from-bag '
                          'drives nothing')
    if not 0 <= arguments.cars <= MAX_CARS:
        raise BridgeError(f'--cars is {arguments.cars}; accepted: 0 (one alone) to {MAX_CARS}')
    if arguments.from_bag and (arguments.cars or arguments.role):
        raise BridgeError('--cars and --role are of a graph, which --from-bag does without')
    if arguments.bag and arguments.role:
        raise BridgeError('--bag records cars, which --role learner does without; on their hosts: '
                          'carracing bag record')
    if arguments.bag and arguments.from_bag:
        raise BridgeError('--bag records a graph, which --from-bag does without')
    if arguments.tensorboard and importlib.util.find_spec('tensorboard') is None:
        raise BridgeError("--tensorboard needs the package 'tensorboard': pip install tensorboard")


def _overrides(pairs: list[str]) -> dict[str, Any]:
    """Return the hyperparameters that were asked for by name; raises SettingsError."""
    for pair in pairs:
        # the trainer node takes them as one text
        if ',' in pair:
            raise SettingsError(f'{plain(pair)!r}: a comma stands between settings and in none; '
                                'give the file or folder another name')
    try:
        return read_overrides(pairs)
    except SettingsError as error:
        raise SettingsError(f'--set: {error}; {LIST_HINT}') from None


def _pairs(arguments: argparse.Namespace, preset: str, folder: Path) -> list[str]:
    """Return NAME=VALUE of what differs from the preset; the last of a name counts."""
    minutes = [] if arguments.minutes is None else [f'run_minutes={arguments.minutes}']
    simulator = pairs_of_simulator(arguments.simulator, preset, folder)
    model = pairs_of_model(arguments.initial_model, preset, simulator, folder)
    shown = [f'demonstrations={DEMONSTRATIONS}'] if arguments.demonstrations else []
    return [*simulator, *model, *shown, *arguments.set, *minutes]


def _what_next(folder: Path, before: str = '') -> str:
    """Return how to go on with a run that has a checkpoint, after some text; else nothing."""
    if not RunFolder(folder).checkpoint.is_file():
        return ''
    return f'{before}go on with: carracing train --resume {shell_word(folder)}'


def _graph(
    arguments: argparse.Namespace, hyperparameters: Hyperparameters, folder: Path,
    done: ResumePoint, vehicle: Mapping[str, Any],
) -> Graph:
    preset = choose_preset(arguments.preset, arguments.simulator)
    if Path(os.path.expanduser(preset)).is_file():
        # paths count from the run folder, which is where the nodes are
        preset = os.path.relpath(Path(os.path.expanduser(preset)).resolve(), folder.resolve())
    trainer = {'run': '.', 'resume': arguments.resume is not None, 'preset': preset,
               'overrides': ','.join(arguments.pairs), 'tensorboard': arguments.tensorboard}
    bag = next_bag(folder).name if arguments.bag else None
    if arguments.role:
        graph = learner_graph(
            hyperparameters, cars=arguments.cars, vehicle=vehicle, trainer=trainer)
    elif arguments.cars:
        graph = cars_graph(
            hyperparameters, arguments.cars, episodes=done.of_sources,
            first_decision=done.decisions, vehicle=vehicle, trainer=trainer, bag=bag,
            namespace=arguments.namespace)
    else:
        graph = training_graph(
            hyperparameters, first_episode=done.episodes, first_decision=done.decisions,
            vehicle=vehicle, trainer=trainer, bag=bag)
    return with_provenance(graph, preset=Path(preset).stem)


def next_bag(folder: Path) -> Path:
    """Return a bag folder that does not exist yet: bag, then bag-1, bag-2 after resumes."""
    path, number = folder / 'bag', 0
    while path.exists():
        number += 1
        path = folder / f'bag-{number}'
    return path


def hyperparameter_lines(hyperparameters: Hyperparameters, width: int) -> list[str]:
    """Return every hyperparameter with its value, what it accepts and what it means, as lines."""
    lines = []
    for name, (kind, _, description) in describe(Hyperparameters).items():
        accepted = description.accepted or ('true or false' if kind is bool else kind.__name__)
        value = getattr(hyperparameters, name)
        shown = str(value).lower() if kind is bool else str(value)
        lines.append(f'{name}={shown}  ({accepted})')
        lines += textwrap.wrap(description.text, width, initial_indent='    ',
                               subsequent_indent='    ')
    return lines
