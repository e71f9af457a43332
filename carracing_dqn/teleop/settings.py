# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of teleop_node and race_node, each described once."""
from __future__ import annotations

import dataclasses

from dqn_policy_node.command_stage import CommandSettings
from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class TerminalKeySettings:
    """How keys of a terminal drive."""

    keyboard: bool = setting(
        True, 'keys of the terminal that the node was started in: up and down change the pedal '
        'and stay, left and right steer while they are held, space lets go of everything')
    key_hold: float = setting(
        0.4, 'seconds that a key for steering counts as held; a terminal repeats it, but does '
        'not say when it is let go', low=0.05, high=5.0)
    key_step: float = setting(0.2, 'of the pedal for each press of up or down', low=0.01, high=1.0)
    key_steering: float = setting(0.6, 'of full lock while a key is held', low=0.05, high=1.0)


@dataclasses.dataclass(frozen=True)
class HandSettings:
    """A joystick, and how fast time goes while a person drives."""

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
    wait_for_subscribers: int = setting(
        0, "subscriptions of cmd_vel, the simulator's among them, to wait for before the first "
        'answer, so that a recorder misses none', low=0, high=100)


@dataclasses.dataclass(frozen=True)
class TeleopSettings(CommandSettings, HandSettings, TerminalKeySettings):
    """What can be set on the teleop node."""


@dataclasses.dataclass(frozen=True)
class HeldKeySettings:
    """How keys of a window drive, which says when they are let go."""

    gas: float = setting(1.0, 'pedal while the key for gas is held', low=0.01, high=1.0)
    gas_in_bends: float = setting(
        0.2, 'what of it is left at the most steering: full gas spins a car with driven rear '
        'wheels', low=0.0, high=1.0)
    brake: float = setting(
        0.4, 'pedal while the key for the brake is held; from about 0.9 on wheels of CarRacing '
        'lock', low=0.01, high=1.0)
    steering: float = setting(
        0.4, 'most steering of a key; at 0.4 the wheels of CarRacing are at full lock',
        low=0.05, high=1.0)
    steering_rate: float = setting(
        2.0, 'how fast a held key gets there, 1/s; let go, it is straight at once',
        low=0.1, high=1000.0)


@dataclasses.dataclass(frozen=True)
class RaceSettings(CommandSettings, HandSettings, HeldKeySettings):
    """What can be set on the race node."""

    rivals: str = setting(
        '', "JSON file of the model's laps by track, as `carracing race` writes it; empty: none")
    laps: int = setting(0, 'laps to drive, to be shown; 0 = no end', low=0, high=10**9)
    scale: int = setting(
        6, 'size of a pixel of the image in pixels of the window', low=1, high=20)
