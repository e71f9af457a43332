# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Begin a run from a preset, or go on with one, as the command line and the node ask for it."""
from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
from pathlib import Path
import shutil
from types import MappingProxyType
from typing import Any, NamedTuple, TYPE_CHECKING

from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.machine import computes_bfloat16
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import parse_text
from trainer_node.checkpoint import Checkpoint, refuse_differences
from trainer_node.errors import RunError
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.run_folder import RunFolder

if TYPE_CHECKING:
    from trainer_node.training import Training


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
            raise SettingsError(f'{plain(pair)!r}; expected NAME=VALUE')
        overrides[name] = parse_text(Hyperparameters, name, text)
    return overrides


def run_settings(
    folder: Path | str, preset: str, overrides: dict[str, Any], *, resume: bool,
) -> Hyperparameters:
    """
    Return the hyperparameters of a new run, or those a run goes on with.

    A new run has bfloat16 arithmetic where its preset has and the machine does too, or where it
    was asked for by name.

    Raises:
        SettingsError: no such preset or run, or a value that is not accepted.
    """
    if not resume:
        settings = load_preset(preset, overrides)
        if settings.bf16 and 'bf16' not in overrides and not computes_bfloat16():
            settings = dataclasses.replace(settings, bf16=False)
        return settings
    run = RunFolder(folder)
    if not run.config.is_file():
        raise SettingsError(f'{folder} is no run folder: it has no {run.config.name}')
    return load_preset(run.config, overrides)


class ResumePoint(NamedTuple):
    """What a run has behind it: episodes, decisions, and episodes by name of its sources."""

    episodes: int = 0
    decisions: int = 0
    of_sources: Mapping[str, int] = MappingProxyType({})


def resume_point(folder: Path | str, settings: Hyperparameters) -> ResumePoint:
    """
    Return what a run has behind it; nothing when it has no checkpoint yet.

    Raises:
        RunError: it cannot go on with these settings, or its folder cannot be written.
    """
    run = RunFolder(folder)
    run.check_writable()
    if run.unfinished_start:
        return ResumePoint()
    saved = Checkpoint(run.checkpoint).read()
    refuse_differences(settings, saved.settings, run.path)
    learning = saved.state.get('learning')
    try:
        found = ResumePoint(learning['episodes'], learning['decisions'], {
            name: of['episodes'] for name, of in learning.get('sources', {}).items()})
    except (TypeError, KeyError, AttributeError):
        found = ResumePoint(-1)
    if not all(type(count) is int and count >= 0 for count in (
            found.episodes, found.decisions, *found.of_sources.values())):
        raise RunError(f'{run.checkpoint}: damaged checkpoint: it counts no episodes')
    return found


def open_training(
    folder: Path | str, settings: Hyperparameters, *, resume: bool, **options: Any,
) -> Training:
    """
    Begin a run or go on with one; `options` are those of `Training.create`.

    A run that was killed before its first checkpoint begins again when it is resumed.

    Raises:
        RunError, LearningError: why that cannot be.
    """
    # on first use, because torch takes a second to load
    from trainer_node.training import Training
    run = RunFolder(folder)
    # before anything of another one's is touched, which may be beginning at this moment
    new = not resume and run.make()
    run.lock()
    if resume and not run.unfinished_start:
        return Training.resume(folder, settings, **options)
    try:
        return Training.create(settings, folder, **options)
    except BridgeError:
        if new:
            run.unlock()
            shutil.rmtree(run.path, ignore_errors=True)
        raise
