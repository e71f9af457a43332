# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing check`: what of a running simulator or robot does not fit its profile, and a cure."""
from __future__ import annotations

import argparse

from carracing_dqn.bringup.findings_table import findings_table
from carracing_dqn.bringup.models import choose_model
from carracing_dqn.bringup.monitor import absolute_namespace
from carracing_dqn.bringup.vehicle import policy_settings
from carracing_dqn.simulation.fit import BAD, findings, Wanted
from carracing_dqn.simulation.profiles import Profile, profile_names, profile_of
from carracing_dqn.simulation.registry import simulator_names
from dqn_policy_node.model_folder import load_model
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge.errors import BridgeError
from msgs_bridge.terminal import say
from rich.console import Console

PLAIN_FRAME = (96, 96)
"""What is looked at without a model: CarRacing's width and height."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing check`."""
    parser.add_argument('profile', metavar='PROFILE',
                        help=f'{", ".join(profile_names())}, the path of a YAML file, or the name '
                             'of a simulator without a profile')
    parser.add_argument('--model', default=None,
                        help='model folder or name of a shipped model that is to drive it '
                             '(default: the best that is shipped)')
    parser.add_argument('--seconds', type=float, default=5.0,
                        help='how long to listen (default %(default)s)')
    parser.add_argument('--nudge', action='store_true',
                        help='drive meanwhile: ahead, then left and right, twice, to see whether '
                             'the picture turns as it should; IT MOVES. A simulator in lockstep '
                             'shows nothing without it')
    parser.add_argument('--namespace', default='', help='ROS namespace of the car')


def main(arguments: argparse.Namespace) -> int:
    """Listen, print what fits and what does not; return 0, or 1 if something does not."""
    namespace = absolute_namespace(arguments.namespace)
    if not 0.5 <= arguments.seconds <= 600:
        raise BridgeError(f'--seconds is {arguments.seconds:g}; accepted: 0.5 to 600')
    profile = profile_of(arguments.profile)
    if profile == Profile() and arguments.profile not in simulator_names():
        raise BridgeError(f'no profile {arguments.profile[:100]!r}: neither a file that ends with '
                          f'.yaml nor one of {", ".join(simulator_names())}')
    settings = policy_settings(arguments.profile, profile.vehicle)
    frame, seconds = _seen_by(arguments.model)
    # rclpy takes a second to load, and a wrong word needs none
    from carracing_dqn.bringup.check_node import look
    console = Console()
    say(console, f'listening for {arguments.seconds:g} s'
        + (', and driving' if arguments.nudge else ''))
    seen = look(settings, frame, namespace=namespace, remaps=dict(profile.topics),
                seconds=arguments.seconds, nudge=arguments.nudge)
    found = list(findings(seen, Wanted(profile.vehicle, profile.camera, frame, seconds)))
    console.print(findings_table(found))
    return int(any(one.verdict == BAD for one in found))


def _seen_by(model: str | None) -> tuple[tuple[int, int], float]:
    """Return width and height of a model's frames, and for how many seconds it holds an action."""
    name = choose_model(model)
    if name == RANDOM:
        return PLAIN_FRAME, float('inf')
    description = load_model(name).description
    preprocessing = description.preprocessing
    return ((preprocessing.frame_width, preprocessing.frame_height), description.action_seconds)
