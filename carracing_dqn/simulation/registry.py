# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulators by name.

Those of this package are listed here. Other packages offer theirs in their metadata, as entry
points `name = module:Class` of the group `carracing_dqn.simulators`; a profile
(`carracing_dqn/simulation/profiles.py`) is the name of the simulator that it makes of another; and
without any of that a simulator is named `module:Class`.
"""
from __future__ import annotations

from collections.abc import Mapping
import contextlib
import functools
import importlib
from importlib.metadata import entry_points
import os
from pathlib import Path
import sys
from typing import Any

from carracing_dqn.simulation.checks import blamed, Checks
from carracing_dqn.simulation.profiles import (
    as_simulator, find_profile, load_profile, profile_names,
)
from msgs_bridge.errors import SettingsError, SimulatorError
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import check_value, describe, from_mapping
from msgs_bridge.simulator import Simulator

SIMULATORS = {
    'carracing': 'carracing_sim_node.simulator:CarRacing',
    # its older name
    'fast': 'carracing_sim_node.simulator:CarRacing',
    'gymnasium': 'carracing_sim_node.stock:GymnasiumCarRacing',
    'gymnasium_env': 'carracing_dqn.simulators.gymnasium_env:GymnasiumEnv',
    'mujoco': 'carracing_dqn.simulators.mujoco_car:MujocoCar',
    'mujoco_robot': 'carracing_dqn.simulators.mujoco_car:MujocoRobot',
    'pyracerz': 'carracing_dqn.simulators.pyracerz:PyRacerz',
}
GROUP = 'carracing_dqn.simulators'
DEFAULT = 'carracing'
CARRACING = ('carracing', 'fast', 'gymnasium')
"""Names of CarRacing itself, whose tracks can be drawn and which the seed document is about."""
# what a simulator must have beside what `Simulator` gives to those who inherit from it
OWED = ('reset', 'advance', 'skip', 'close', 'Settings')


@functools.cache
def _registered() -> dict[str, str]:
    """Return name -> `module:Class`; nobody else takes a name of ours."""
    return {**{point.name: point.value for point in entry_points(group=GROUP)}, **SIMULATORS}


def simulator_names() -> list[str]:
    """Return the names of the simulators that are installed."""
    return sorted({*_registered(), *profile_names()})


def find_simulator(name: str, *, registered_only: bool = False) -> type[Simulator]:
    """
    Return the simulator of a name.

    Args:
        name: of a simulator that is installed, of a profile, the path of one (.yaml), or
            `module:Class`, which is imported.
        registered_only: take installed ones alone, for names that come from a file.

    Raises:
        SimulatorError: there is none, or it lacks what a simulator owes.
        SettingsError: a profile that is none, or settings that cannot become parameters.
    """
    # the metadata of all packages is only read for names that are not ours
    place = SIMULATORS.get(name)
    if place is None and (path := find_profile(name, shipped_only=registered_only)):
        return _of_profile(path)
    place = place or _registered().get(name)
    if place is None:
        if registered_only or ':' not in name:
            raise SimulatorError(f'simulator is {_shown(name)}; accepted: '
                                 f'{", ".join(simulator_names())}; PROFILE.yaml; or module:Class')
        place = name
        look_here()
    found = _load(place, name)
    missing = [what for what in OWED if not hasattr(found, what)]
    if not isinstance(found, type) or missing:
        raise SimulatorError(
            f'simulator {_shown(name)} is none: {", ".join(missing) or "a class"} is missing; '
            'inherit from msgs_bridge.simulator.Simulator')
    _check_settings(found.Settings, name)
    return found


def look_here() -> None:
    """Let modules of the current folder be found: only `python -m` looks there by itself."""
    # which may have been removed
    with contextlib.suppress(OSError):
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())


def make_simulator(name: str, values: Mapping[str, Any] | None = None) -> Simulator:
    """
    Make the simulator of a name.

    Args:
        name: as `find_simulator` takes it.
        values: settings by name; its defaults where they are silent.

    Raises:
        SimulatorError: there is none, or it cannot run here.
        SettingsError: a setting that is unknown or not accepted.
    """
    kind = find_simulator(name).Settings
    # it may check itself
    with blamed(name, 'Settings'):
        settings = from_mapping(kind, dict(values or {}))
    return construct(name, settings)


def construct(name: str, settings: Any) -> Simulator:
    """
    Make the simulator of a name with an instance of its settings class.

    Raises:
        SimulatorError: there is none, or it cannot be made.
    """
    kind = find_simulator(name)
    with blamed(name, '__init__'):
        return kind(settings)


def frame_seconds(name: str) -> float:
    """
    Return the simulated seconds of a frame of the simulator of a name.

    Raises:
        SimulatorError, SettingsError: as `make_simulator`.
    """
    checks, kind = Checks(name), find_simulator(name)
    if isinstance(getattr(kind, 'frame_seconds', None), (int, float)):
        return checks.frame_seconds(kind)
    # only one that is made knows its own
    simulator = make_simulator(name)
    try:
        return checks.frame_seconds(simulator)
    finally:
        checks.close(simulator)


@functools.cache
def _of_profile(path: Path) -> type[Simulator]:
    profile = load_profile(path)
    if not profile.simulator:
        raise SimulatorError(f'{path} describes what runs by itself: it names no simulator')
    if profile.simulator not in SIMULATORS and find_profile(profile.simulator):
        raise SimulatorError(f'{path}: simulator is {_shown(profile.simulator)}, a profile itself')
    return as_simulator(profile, path, find_simulator(profile.simulator))


def _load(place: str, name: str) -> Any:
    module_name, _, path = place.partition(':')
    try:
        found: Any = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        # somebody's file may raise anything when it is read
        raise SimulatorError(f'simulator {_shown(name)}: cannot import {_shown(module_name)}: '
                             f'{type(error).__name__}: {plain(error)}') from None
    for part in path.split('.'):
        try:
            found = getattr(found, part)
        except AttributeError:
            raise SimulatorError(
                f'simulator {_shown(name)}: {_shown(module_name)} has no {_shown(path)}') from None
        except (Exception, SystemExit) as error:
            # a module may import what it offers only now
            raise SimulatorError(f'simulator {_shown(name)}: {_shown(module_name)} cannot give '
                                 f'{_shown(path)}: {type(error).__name__}: {plain(error)}'
                                 ) from None
    return found


def _check_settings(settings_class: Any, name: str) -> None:
    """Raise SettingsError unless a settings class is one whose fields `setting()` has made."""
    try:
        for one, (kind, default, description) in describe(settings_class).items():
            if kind not in (int, float, str, bool):
                raise SettingsError(f'{one} must be an int, float, str or bool')
            check_value(one, kind, description, default)
        if not settings_class.__dataclass_params__.frozen:
            raise SettingsError('it is not frozen')
    except Exception as error:
        # a class that is no dataclass, a field without a description, a hint that means nothing
        reason = str(error) if isinstance(error, SettingsError) else repr(error)
        raise SettingsError(
            f'simulator {_shown(name)}: Settings is no class of settings ({plain(reason)}); make '
            'it a frozen dataclass of fields made with msgs_bridge.settings.setting') from None


def _shown(text: str) -> str:
    return repr(text[:100])
