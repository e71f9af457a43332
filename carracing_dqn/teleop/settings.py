# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of teleop_node, each described once."""
from __future__ import annotations

import dataclasses

from dqn_policy_node.command_stage import CommandSettings
from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class HandSettings:
    """What a person drives with, and how fast time goes meanwhile."""

    keyboard: bool = setting(
        True, 'keys of the terminal that the node was started in: up and down change the pedal '
        'and stay, left and right steer while they are held, space lets go of everything')
    key_hold: float = setting(
        0.4, 'seconds that a key for steering counts as held; a terminal repeats it, but does '
        'not say when it is let go', low=0.05, high=5.0)
    key_step: float = setting(0.2, 'of the pedal for each press of up or down', low=0.01, high=1.0)
    key_steering: float = setting(0.6, 'of full lock while a key is held', low=0.05, high=1.0)
    linear_axis: int = setting(
        1, 'axis of joy for the pedal, forward above 0; -1 = none', low=-1, high=63)
    angular_axis: int = setting(
        0, 'axis of joy for steering, left above 0; -1 = none', low=-1, high=63)
    deadman_button: int = setting(
        -1, 'button of joy that has to be held to drive; -1 = none', low=-1, high=63)
    dead_zone: float = setting(
        0.05, 'what of an axis counts as let go', low=0.0, high=0.9)
    stale_after: float = setting(
        0.5, 'seconds without a message on joy after which it counts as let go',
        low=0.05, high=60.0)
    real_time_factor: float = setting(
        1.0, 'a simulator in lockstep waits for the answer, which is given when its time has '
        'passed, so much faster than on the wall; 0 = at once', low=0.0, high=100.0)
    image_compressed: bool = setting(
        False, 'true: image_raw is a CompressedImage; its stamps are all that is looked at')
    cmd_vel_stamped: bool = setting(True, 'false: publish a plain Twist')


@dataclasses.dataclass(frozen=True)
class TeleopSettings(CommandSettings, HandSettings):
    """What can be set on the teleop node."""
