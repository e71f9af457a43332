# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Begin a run from a preset, or go on with one, as the command line and the node ask for it."""
from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import parse_text
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.run_folder import RunFolder


def read_overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """
    Return hyperparameters from NAME=VALUE texts.

    Raises:
        SettingsError: a text without an equals sign, an unknown name, a value not accepted.
    """
    overrides = {}
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition('='))
        if not equals:
            raise SettingsError(f'{pair!r}; expected NAME=VALUE')
        overrides[name] = parse_text(Hyperparameters, name, text)
    return overrides


def run_settings(
    folder: Path | str, preset: str, overrides: dict[str, Any], *, resume: bool,
) -> Hyperparameters:
    """
    Return the hyperparameters of a new run, or those a run goes on with.

    Raises:
        SettingsError: no such preset or run, or a value that is not accepted.
    """
    if not resume:
        return load_preset(preset, overrides)
    config = RunFolder(folder).config
    if not config.is_file():
        raise SettingsError(f'{folder} is no run folder: it has no {config.name}')
    return load_preset(config, overrides)
