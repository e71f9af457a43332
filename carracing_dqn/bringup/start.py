# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the executables start, and the one line that they say where the machine lacks something."""
from __future__ import annotations

from collections.abc import Callable
import importlib
import os
import resource
import sys

from msgs_bridge.early_interrupt import ends_when_interrupted
from msgs_bridge.exit_codes import ERROR, INTERRUPTED
from msgs_bridge.last_line import say

FEWEST_FILES = 32
"""Files that a node must be able to have open at once: 26 before its first topic."""

ENOUGH_FILES = 1024

LEAST_MEMORY = 384 << 20
"""Bytes of address space with less of which libraries end the process while they are loaded."""


def _starting(module: str, interrupted: int = 0) -> Callable[[], int]:
    """Return a `main` that imports a module's, which takes seconds, and runs it."""
    def main() -> int:
        _fill_streams()
        files, memory = _allow_open_files(), resource.getrlimit(resource.RLIMIT_AS)[0]
        if files < FEWEST_FILES:
            reason = (f'only {files} files may be open at once, {FEWEST_FILES} is the least: '
                      f'`ulimit -n {ENOUGH_FILES}` allows more')
        elif memory != resource.RLIM_INFINITY and memory < LEAST_MEMORY:
            reason = (f'only {memory >> 20} MiB of memory may be used, {LEAST_MEMORY >> 20} is '
                      'the least: `ulimit -v unlimited` allows more')
        else:
            try:
                with ends_when_interrupted(interrupted):
                    imported = importlib.import_module(module)
                return imported.main()
            except ModuleNotFoundError as error:
                from carracing_dqn.bringup.command import missing_package
                reason = missing_package(error)
            except KeyboardInterrupt:
                # stopped before it had begun
                return interrupted
        say(f'error: {reason}')
        return ERROR

    return main


def _fill_streams() -> None:
    """Let a stream that was closed before we began lead nowhere; Python has None in its place."""
    for name, mode in (('stdin', 'r'), ('stdout', 'w'), ('stderr', 'w')):
        if getattr(sys, name) is None:
            # lowest first, so that each gets the number it should have, for our children, too
            number = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, encoding='utf-8'))


def _allow_open_files() -> int:
    """Raise a low limit of open files as far as this user may; return what it is now."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if now == resource.RLIM_INFINITY or now >= ENOUGH_FILES:
        return ENOUGH_FILES
    now = ENOUGH_FILES if most == resource.RLIM_INFINITY else min(ENOUGH_FILES, most)
    resource.setrlimit(resource.RLIMIT_NOFILE, (now, most))
    return now


carracing = _starting('carracing_dqn.bringup.command', INTERRUPTED)
carracing_sim_node = _starting('carracing_sim_node.node')
gymnasium_sim_node = _starting('carracing_dqn.simulators.gymnasium_node')
mujoco_robot_node = _starting('carracing_dqn.simulators.mujoco_robot_node')
referee_node = _starting('carracing_dqn.simulation.referee_node')
dqn_policy_node = _starting('dqn_policy_node.node')
trainer_node = _starting('trainer_node.node')
validation_node = _starting('carracing_dqn.evaluation.node')
bag_recorder_node = _starting('bags.recorder_node')
bag_player_node = _starting('bags.player_node')
image_annotator_node = _starting('carracing_dqn.watch.annotator_node')
race_node = _starting('carracing_dqn.teleop.race_node')
teleop_node = _starting('carracing_dqn.teleop.teleop_node')
