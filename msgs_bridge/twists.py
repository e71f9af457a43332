# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Twists <-> the action of CarRacing, the one place that knows the signs.

REP-103: positive angular.z is a turn to the left; CarRacing's positive steer is to the right.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from msgs_bridge.errors import MessageError


class Action(NamedTuple):
    """One action of CarRacing: steer in [-1, 1] (right > 0), gas and brake in [0, 1]."""

    steer: float
    gas: float
    brake: float


COAST = Action(0.0, 0.0, 0.0)


def twist_to_action(twist: object) -> tuple[Action, bool]:
    """
    Return the action of a geometry_msgs/Twist and whether it had to be clamped to [-1, 1].

    Raises:
        MessageError: linear.x or angular.z is not finite.
    """
    forward, left = twist.linear.x, twist.angular.z
    if not (math.isfinite(forward) and math.isfinite(left)):
        raise MessageError(f'twist with linear.x {forward} and angular.z {left}')
    clamped = abs(forward) > 1 or abs(left) > 1
    forward, left = max(-1.0, min(1.0, forward)), max(-1.0, min(1.0, left))
    return Action(-left + 0.0, max(forward, 0.0), max(-forward, 0.0)), clamped


def fill_twist(twist: object, action: Action) -> object:
    """
    Write an action into a geometry_msgs/Twist; return it.

    Raises:
        MessageError: gas and brake at once, which one signed number cannot carry.
    """
    steer, gas, brake = action
    if gas > 0 and brake > 0:
        raise MessageError(f'a twist cannot carry gas {gas} and brake {brake} at once')
    twist.linear.x = float(gas - brake)
    twist.angular.z = float(-steer + 0.0)
    return twist
