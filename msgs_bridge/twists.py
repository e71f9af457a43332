# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Twists <-> commands: the two numbers of a geometry_msgs/Twist that a ground vehicle obeys.

REP-103: x is forward, a positive rotation about z is a turn to the left.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from msgs_bridge.errors import MessageError


class Command(NamedTuple):
    """
    What a driver wants: linear.x (forward > 0) and angular.z (left > 0).

    Between a policy and a simulator of ours both are in [-1, 1]: full brake or reverse to full
    gas, full right to full left. A robot takes m/s and rad/s.
    """

    linear: float
    angular: float

    def clamped(self) -> Command:
        """Return the command within [-1, 1]."""
        return Command(*(max(-1.0, min(1.0, value)) for value in self))


STOP = Command(0.0, 0.0)


def read_command(twist: object) -> Command:
    """
    Return the command of a geometry_msgs/Twist.

    Raises:
        MessageError: linear.x or angular.z is not finite.
    """
    linear, angular = twist.linear.x, twist.angular.z
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise MessageError(f'twist with linear.x {linear} and angular.z {angular}')
    return Command(linear, angular)


def fill_twist(twist: object, command: Command) -> object:
    """Write a command into a geometry_msgs/Twist; return it."""
    twist.linear.x, twist.angular.z = map(float, command)
    return twist
