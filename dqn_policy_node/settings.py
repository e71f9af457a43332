# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of dqn_policy_node, each described once."""
from __future__ import annotations

import dataclasses

from dqn_policy_node.camera import CameraSettings
from dqn_policy_node.command_stage import CommandSettings
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class DrivingSettings:
    """What drives, and when it stops."""

    model: str = setting(
        'racing', 'model folder or name of a shipped model; random: uniform random actions (the '
        'dummy agent of seed document 3.2.3); empty: wait for the first message on weights')
    hot_swap: bool = setting(True, 'take new weights from the weights topic')
    explore: bool = setting(
        False, 'true: follow the epsilon that comes with the weights (training)')
    epsilon_exponent: float = setting(
        1.0, 'with explore: what that epsilon is raised to; of several cars, each has its own '
        '(arXiv 1803.00933)', low=0.01, high=1000.0)
    epsilon: float = setting(
        0.0, 'share of uniform random actions (epsilon-greedy), unless explore is on',
        low=0.0, high=1.0, live=True)
    seed: int = setting(0, 'seed of the random actions', low=0, high=2**31 - 1)
    device: str = setting('auto', 'where the network runs', choices=('auto', 'cpu', 'cuda'))
    cmd_vel_stamped: bool = setting(
        True, 'false: publish a plain Twist, for simulators and robots that know no other')
    frame_id: str = setting('', 'header.frame_id of the twists, such as base_link')
    wait_for_subscribers: int = setting(
        0, "subscriptions of cmd_vel, the simulator's among them, to wait for before the first "
        'answer, so that trainer and recorder miss none', low=0, high=100)
    sequence_gap: float = setting(
        0.5, 'seconds between two stamps from which on the frame stack starts anew',
        low=0.05, high=60.0)
    stale_after: float = setting(
        0.0, 'seconds of wall time without an image after which one zero twist is sent; 0 = never '
        '(our simulator has a guard of its own); give it for a robot', low=0.0, high=60.0)


@dataclasses.dataclass(frozen=True)
class PolicySettings(CommandSettings, CameraSettings, DrivingSettings):
    """What can be set on the policy node."""

    def __post_init__(self) -> None:
        """Check what concerns more than one value; raises SettingsError."""
        super().__post_init__()
        if not self.model and not self.hot_swap:
            raise SettingsError(
                'model is empty, which waits for weights, and hot_swap is false, which takes '
                'none: name a model, or set hot_swap')
