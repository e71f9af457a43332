# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulator profiles: what one simulator or robot needs, as a YAML file.

A profile that names the simulator it stands on is itself the name of a simulator, wherever one is
chosen: the same class with other settings. One that names none describes a simulator or a robot
that runs by itself.
"""
from __future__ import annotations

from collections.abc import Mapping
import contextlib
import dataclasses
import functools
import importlib.util
import math
import os
from pathlib import Path
import re
from typing import Any

from msgs_bridge import topics
from msgs_bridge.errors import SettingsError, SimulatorError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.settings import check_value, describe, unknown_setting
from msgs_bridge.share import share_folders
from msgs_bridge.simulator import Simulator
from msgs_bridge.yaml_text import dump_yaml, load_yaml

FOLDER = Path('config') / 'simulators'
SUFFIX = '.yaml'
MAX_BYTES = 1 << 16


@dataclasses.dataclass(frozen=True)
class Profile:
    """
    What is known of a simulator or a robot.

    Attributes:
        about: what it is, in one line.
        simulator: name of the simulator that it stands on; empty: it runs by itself.
        deterministic: whether the same seed and commands give the same outcomes to the last bit;
            None: as the simulator says.
        needs: what must be installed, module -> how.
        settings: other defaults for the parameters of the simulator's node; what is no text,
            number or truth value is handed on as YAML.
        vehicle: parameters of policy and trainer: camera, units and limits of the commands.
        topics: remaps, relative name -> name.
        camera: what its images are like: `width`, `height`, `encoding`, `rate` in Hz by stamp,
            `mean_rgb`; `patch`, a part of them (left, top, width, height) whose mean colour is
            `patch_rgb`; what `carracing check` and `watch` compare with.
        training: `preset` and hyperparameters of `carracing train`.
    """

    about: str = ''
    simulator: str = ''
    deterministic: bool | None = None
    needs: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    vehicle: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    topics: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    camera: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _are_numbers(value: object, length: int) -> bool:
    return isinstance(value, list) and len(value) == length and all(map(_is_number, value))


# https://design.ros2.org/articles/topic_and_service_names.html
TOPIC_NAMES = tuple(
    topic.name for topic in (*topics.TOPICS, *topics.VIEW_TOPICS, *topics.ROBOT_TOPICS))
TOPIC_NAME = re.compile(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
CAMERA = {
    'width': lambda value: type(value) is int and value > 0,
    'height': lambda value: type(value) is int and value > 0,
    'encoding': lambda value: isinstance(value, str),
    'rate': lambda value: _is_number(value) and value > 0,
    'mean_rgb': lambda value: _are_numbers(value, 3),
    'patch': lambda value: _are_numbers(value, 4) and all(
        type(one) is int and one >= 0 for one in value) and value[2] * value[3] > 0,
    'patch_rgb': lambda value: _are_numbers(value, 3),
}
KINDS = {'about': str, 'simulator': str, 'deterministic': bool}


def profile_names() -> list[str]:
    """Return the names of the profiles that come with the package."""
    return sorted({path.stem for folder in share_folders()
                   for path in (folder / FOLDER).glob(f'*{SUFFIX}')})


def find_profile(name: str, *, shipped_only: bool = False) -> Path | None:
    """
    Return the file of a profile: that of a shipped one's name, or a path that ends with .yaml.

    Args:
        name: of the profile.
        shipped_only: take those of the package alone, for names that come from a file.
    """
    for folder in share_folders():
        path = folder / FOLDER / f'{name}{SUFFIX}'
        # a name may be longer than a file's may be
        with contextlib.suppress(OSError):
            if path.parent == folder / FOLDER and path.is_file():
                return path
    if name.endswith(SUFFIX) and not shipped_only:
        return Path(os.path.expanduser(name))
    return None


def load_profile(path: Path) -> Profile:
    """
    Read a profile.

    Raises:
        SettingsError: no such file, or one line that says what of it is not accepted.
    """
    text = read_regular(path, MAX_BYTES, SettingsError).decode('utf-8', 'replace')
    content = load_yaml(text, str(path), SettingsError)
    if not isinstance(content, dict):
        raise SettingsError(f'{path}: a profile is a mapping of names to values')
    known = [field.name for field in dataclasses.fields(Profile)]
    for name, value in content.items():
        if name not in known:
            raise SettingsError(f'{path}: {unknown_setting(name, known)}')
        kind = KINDS.get(name, dict)
        if type(value) is not kind or (kind is dict and not all(map(_is_name, value))):
            what = {str: 'a text', bool: 'true or false'}.get(kind, 'a mapping of names')
            raise SettingsError(f'{path}: {name} must be {what}')
    _check_parts(path, content)
    return Profile(**content)


def _check_parts(path: Path, content: dict[str, Any]) -> None:
    """Raise SettingsError for a part of a profile that cannot be, or that nobody would read."""
    if not content.get('simulator'):
        for name in ('settings', 'needs'):
            if content.get(name):
                raise SettingsError(f'{path}: {name} are those of a simulator, and it names none; '
                                    'what drives a robot is set under vehicle')
    for module, install in content.get('needs', {}).items():
        if not (module.isidentifier() and isinstance(install, str)):
            raise SettingsError(f'{path}: needs: {plain(module)} cannot be {plain(install)!r}; '
                                'accepted: the name of a module, and how to install it')
    for name, topic in content.get('topics', {}).items():
        if name not in TOPIC_NAMES:
            raise SettingsError(f'{path}: topics: {unknown_setting(name, TOPIC_NAMES)}')
        if not (isinstance(topic, str) and TOPIC_NAME.fullmatch(topic)):
            raise SettingsError(
                f'{path}: topics: {plain(name)} cannot be {plain(topic)!r}; accepted: names of '
                'letters, digits and underscores, joined by /')
    for name, value in content.get('camera', {}).items():
        if name not in CAMERA:
            raise SettingsError(f'{path}: camera: {unknown_setting(name, CAMERA)}')
        if not CAMERA[name](value):
            raise SettingsError(f'{path}: camera: {name} cannot be {value!r:.60}')


def _is_name(key: object) -> bool:
    return isinstance(key, str)


def as_simulator(profile: Profile, path: Path, base: type[Simulator]) -> type[Simulator]:
    """
    Return the class of a simulator with the defaults of a profile.

    Raises:
        SimulatorError: what it needs is not installed.
        SettingsError: a setting that the simulator does not have, or a value not accepted.
    """
    for module, install in profile.needs.items():
        if not _is_installed(module):
            raise SimulatorError(f'{path.stem}: {module} is not installed: {install}')
    known = describe(base.Settings)
    fields = []
    for name, value in profile.settings.items():
        if name not in known:
            raise SettingsError(f'{path}: settings: {unknown_setting(name, known)}')
        kind, _, description = known[name]
        if kind is str and not isinstance(value, str):
            # after a value without parts YAML writes that the document ends
            value = dump_yaml(value).removesuffix('...\n').strip()
        try:
            value = check_value(name, kind, description, value)
        except SettingsError as error:
            raise SettingsError(f'{path}: settings: {error}') from None
        fields.append((name, kind, dataclasses.field(
            default=value, metadata={'description': description})))
    # a name of a file may be no text, that of a class may not
    settings = dataclasses.make_dataclass(
        f'{base.Settings.__name__}Of{plain(path.stem)}', fields, bases=(base.Settings,),
        frozen=True)
    return type(base.__name__, (base,), {
        'Settings': settings,
        'deterministic': (base.deterministic if profile.deterministic is None
                          else profile.deterministic),
        '__doc__': profile.about or base.__doc__})


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ValueError:
        # a module that is there already, and from nowhere, as __main__ may be
        return True


def seen_from(name: str, folder: Path | str) -> str:
    """
    Return the name of a simulator as a process in another folder has to say it.

    Only the path of a profile changes. It is relative, because it is recorded: a shared bag should
    not tell whose home it comes from.
    """
    path = _given_by_path(name)
    return os.path.relpath(path.resolve(), Path(folder).resolve()) if path else name


def found_from(name: str, folder: Path | str) -> str:
    """Return here what a process in a folder says: the reverse of `seen_from`."""
    path = _given_by_path(name)
    # the folder may not be there yet
    return os.path.normpath(Path(folder) / path) if path else name


def _given_by_path(name: str) -> Path | None:
    """Return the file of a profile that is named by its path, None for every other simulator."""
    path = find_profile(name)
    return None if path is None or path.stem == name else path


@functools.cache
def profile_of(name: str) -> Profile:
    """
    Return the profile of a name; an empty one where there is none, as for a class of its own.

    Raises:
        SettingsError: as `load_profile`.
    """
    path = find_profile(name)
    return Profile() if path is None else load_profile(path)
