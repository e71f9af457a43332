# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From commands within [-1, 1] to the m/s and rad/s of a robot, and back."""
from __future__ import annotations

import dataclasses

from msgs_bridge.settings import setting
from msgs_bridge.twists import Command


@dataclasses.dataclass(frozen=True)
class CommandScale:
    """
    What a command of 1 and of 0 mean to the robot; the defaults leave commands as they are.

    Policy and trainer have these settings in common: what the one does the other undoes.
    """

    linear_scale: float = setting(
        1.0, 'linear.x in m/s for a command of 1 beyond the offset (our simulators take 1)',
        low=-1000.0, high=1000.0)
    linear_offset: float = setting(
        0.0, 'linear.x in m/s for a command of 0', low=-1000.0, high=1000.0)
    angular_scale: float = setting(
        1.0, 'angular.z in rad/s for a command of 1 (full left) beyond the offset; negative for '
        'a robot with the other sign', low=-1000.0, high=1000.0)
    angular_offset: float = setting(
        0.0, 'angular.z in rad/s for a command of 0', low=-1000.0, high=1000.0)

    def to_robot(self, command: Command) -> Command:
        """Return a command in the robot's units."""
        return Command(
            command.linear * self.linear_scale + self.linear_offset,
            command.angular * self.angular_scale + self.angular_offset)

    def from_robot(self, command: Command) -> Command:
        """Return the command within [-1, 1] that `to_robot` made; 0 for a scale of 0."""
        return Command(
            _undone(command.linear, self.linear_scale, self.linear_offset),
            _undone(command.angular, self.angular_scale, self.angular_offset))


def _undone(value: float, scale: float, offset: float) -> float:
    return (value - offset) / scale if scale else 0.0
