# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of trainer_node, each described once; hyperparameters are in `hyperparameters`."""
from __future__ import annotations

import dataclasses

from dqn_policy_node.camera import CameraSettings
from msgs_bridge.command_scale import CommandScale
from msgs_bridge.settings import setting

# what the diagnostics say when nothing is missing
LEARNING, VALIDATING = 'learning', 'validating the last weights'
PRETRAINING = 'learning from demonstrations'
TOO_SLOW = 'too slow for this recipe'
MOVING_AVERAGE_EPISODES = 20
"""Of `mean_return`, in words the moving average."""


@dataclasses.dataclass(frozen=True)
class RunSettings:
    """Which run, and how it is driven."""

    run: str = setting('runs/training', 'run folder: records, checkpoint and models')
    preset: str = setting('racing', 'name of a shipped preset or path of a YAML file')
    overrides: str = setting(
        '', 'hyperparameters that differ from the preset: name=value,name=value')
    resume: bool = setting(False, 'go on from the checkpoint in the run folder')
    device: str = setting(
        'auto', 'where to learn: CUDA or ROCm when there, or the CPU',
        choices=('auto', 'cpu', 'cuda'))
    sources: str = setting(
        '', 'cars to learn from, by namespace: names or patterns such as /car_*, separated by '
        'commas, which may come and go; empty: the one in the namespace of the trainer')
    cars: int = setting(
        0, 'with sources, cars that are counted on, over which epsilon is spread; more may come',
        low=0, high=1024)
    simulator: str = setting(
        'carracing_sim_node', 'node whose ~/hold is called while learning lags behind, with '
        'sources one in the namespace of each car')
    queue_limit: int = setting(
        64, 'transitions waiting to be learned from at which the simulator is held back',
        low=1, high=100_000)
    last_validation_seconds: float = setting(
        90.0, 'seconds to wait at the end for the validation of the last weights; 0 = do not ask',
        low=0.0, high=3600.0)
    tensorboard: bool = setting(False, 'write TensorBoard event files into the run folder')


@dataclasses.dataclass(frozen=True)
class TrainerSettings(CommandScale, CameraSettings, RunSettings):
    """What can be set on the trainer node; camera and scale as on the policy that drives."""
