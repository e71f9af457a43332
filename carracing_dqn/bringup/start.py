# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the executables start, and the one line that they say where ROS is missing."""
from __future__ import annotations

from collections.abc import Callable
import importlib
import sys


def _starting(module: str) -> Callable[[], int]:
    def main() -> int:
        try:
            return importlib.import_module(module).main()
        except ImportError:
            why = _what_is_wrong_with_ros()
            if why is None:
                raise
            sys.stderr.write(
                f'error: {why}: source the setup file of an installed ROS 2 Jazzy, whose Python '
                "this must be, or `pip install 'carracing_dqn[wheels]'`\n")
            return 2

    return main


def _what_is_wrong_with_ros() -> str | None:
    try:
        importlib.import_module('rclpy')
    except ImportError as error:
        return f'rclpy cannot be imported ({str(error).splitlines()[0]})'
    return None


carracing = _starting('carracing_dqn.bringup.command')
carracing_sim_node = _starting('carracing_sim_node.node')
dqn_policy_node = _starting('dqn_policy_node.node')
trainer_node = _starting('trainer_node.node')
validation_node = _starting('carracing_dqn.evaluation.node')
bag_recorder_node = _starting('bags.recorder_node')
bag_player_node = _starting('bags.player_node')
