# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulator and a first model change in a preset, as NAME=VALUE for the trainer node."""
from __future__ import annotations

from pathlib import Path
from typing import Any

from carracing_dqn.bringup.models import as_parameter
from carracing_dqn.studies.simulator_settings import settings_from
from dqn_policy_node.shipped_models import find_model
from msgs_bridge.errors import SettingsError
from trainer_node.hyperparameters import load_preset, settings_of_model
from trainer_node.open_run import read_overrides


def pairs_of_simulator(name: str | None, preset: str, folder: Path) -> list[str]:
    """
    Return NAME=VALUE of what a simulator looks like and of what its profile says.

    Args:
        name: of the simulator; None for that of the preset, of which nothing is asked.
        preset: of the run.
        folder: of the run, from which its nodes see a profile that is named by its path.

    Raises:
        SimulatorError: it is not there or cannot run.
        SettingsError: its profile's `training` is not accepted.
    """
    if name is None:
        return []
    pairs = [f'{key}={_as_text(value)}'
             for key, value in settings_from(name, preset, folder).items()]
    try:
        read_overrides(pairs)
    except SettingsError as error:
        raise SettingsError(f'simulator {name}: training: {error}') from None
    return pairs


def pairs_of_model(
    name: str | None, preset: str, simulator: list[str], folder: Path,
) -> list[str]:
    """
    Return NAME=VALUE of what beginning with a model needs: its network, stack and actions.

    Args:
        name: of the model; None for random weights.
        preset: of the run.
        simulator: what `pairs_of_simulator` gave.
        folder: of the run, from which its nodes see a model that is named by its path.

    Raises:
        ModelError: it is not there or damaged.
        SettingsError: its actions have no name here.
    """
    if name is None:
        return []
    # on first use, because torch takes a second to load
    from dqn_policy_node.model_folder import load_model
    path = find_model(name)
    seconds = load_preset(preset, read_overrides(simulator)).frame_seconds
    # nodes run in the folder of their run
    values = {'initial_model': as_parameter(str(path), folder),
              **settings_of_model(load_model(path).description, seconds)}
    return [f'{key}={_as_text(value)}' for key, value in values.items()]


def _as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
