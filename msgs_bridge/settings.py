# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One place to describe a setting: type, default, range, unit, meaning and source.

A settings class is a frozen dataclass whose fields are made with `setting()`. ROS parameters,
YAML presets, command-line help and the tables in the documentation are all made from it.
"""
from __future__ import annotations

from collections.abc import Iterable
import dataclasses
import difflib
import math
import textwrap
from typing import Any, get_type_hints, TypeVar

from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import LENGTH, plain

Settings = TypeVar('Settings')


@dataclasses.dataclass(frozen=True)
class Description:
    """What is known of one setting beside its name, type and default."""

    text: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False

    @property
    def accepted(self) -> str:
        """Return the accepted values in words, empty if anything of the type is."""
        if self.choices:
            return 'one of ' + ', '.join(repr(choice) for choice in self.choices)
        if self.low is None:
            return ''
        return f'{_plain(self.low)} to {_plain(self.high)}'


# how a type is called in an error, and an example of what is meant
_KINDS = {int: 'a whole number', float: 'a number', str: 'a text', bool: 'true or false'}


def _plain(number: float) -> str:
    """Return a number as people write it: whole numbers with all their digits."""
    return str(int(number)) if float(number).is_integer() else f'{number:g}'


def setting(
    default: Any,
    text: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """
    Describe a setting in the class body of a settings dataclass.

    Args:
        default: value when nothing is said.
        text: one sentence with unit and, where there is one, the source.
        low: least number accepted; goes with high.
        high: greatest number accepted.
        choices: accepted texts of a str.
        live: whether a running node takes a new value.
    """
    if (low is None) != (high is None):
        raise TypeError('a range needs both ends')
    description = Description(text, low, high, choices, live)
    return dataclasses.field(default=default, metadata={'description': description})


def describe(settings_class: type) -> dict[str, tuple[type, Any, Description]]:
    """Return name -> (type, default, description) in the order of declaration."""
    hints = get_type_hints(settings_class)
    return {
        field.name: (hints[field.name], field.default, field.metadata['description'])
        for field in dataclasses.fields(settings_class)
    }


def numbers(settings: Any, settings_class: type) -> dict[str, float]:
    """
    Return settings that are numbers by name, true and false as 1 and 0.

    Args:
        settings: an instance of `settings_class`, or of a subclass that has more.
        settings_class: whose settings are meant.
    """
    return {name: float(getattr(settings, name))
            for name, (kind, _, _) in describe(settings_class).items() if kind is not str}


def check_value(name: str, kind: type, description: Description, value: Any) -> Any:
    """
    Return the value as its type, or say what is accepted.

    Raises:
        SettingsError: wrong type, not finite, out of range or not among the choices.
    """
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
    if type(value) is not kind:
        raise SettingsError(f'{name} must be {_KINDS[kind]}, not {_shown(value)}')
    if kind is float and not math.isfinite(value):
        raise SettingsError(f'{name} must be finite, not {_shown(value)}')
    if description.choices and value not in description.choices:
        raise SettingsError(f'{name} is {_shown(value)}; accepted: {description.accepted}')
    if description.low is not None and not description.low <= value <= description.high:
        raise SettingsError(f'{name} is {_shown(value)}; accepted: {description.accepted}')
    return value


# the nearest name is told even when it is not near: it shows what names look like
FAR = 0.3


def unknown_setting(name: object, known: Iterable[str]) -> str:
    """Return what is said of a name that is no setting, with the nearest one that is."""
    # a text of megabytes is like no setting, and comparing it takes for ever
    nearest = difflib.get_close_matches(str(name)[:LENGTH], list(known), n=1, cutoff=FAR)
    hint = f'; did you mean {nearest[0]!r}?' if nearest else ''
    return f'unknown setting {_shown(name)}{hint}'


def _shown(value: object) -> str:
    """Return a value as Python writes it, cut if it is long."""
    return plain(repr(value[:LENGTH + 1] if isinstance(value, str) else value))


def from_mapping(settings_class: type[Settings], values: dict[str, Any]) -> Settings:
    """
    Make settings from a mapping, defaults where it is silent.

    Raises:
        SettingsError: an unknown name (with the nearest one) or a value not accepted.
    """
    known = describe(settings_class)
    checked = {}
    for name, value in values.items():
        if name not in known:
            raise SettingsError(unknown_setting(name, known))
        kind, _, description = known[name]
        checked[name] = check_value(name, kind, description, value)
    return settings_class(**checked)


def parse_text(settings_class: type, name: str, text: str) -> Any:
    """
    Read one value that was typed on a command line, by the type of its setting.

    Raises:
        SettingsError: unknown name, or text that is not of the type or not accepted.
    """
    known = describe(settings_class)
    if name not in known:
        from_mapping(settings_class, {name: text})
    kind, _, description = known[name]
    try:
        if kind is bool:
            value = {'true': True, 'false': False}[text.lower()]
        else:
            value = kind(text)
    except (KeyError, ValueError):
        raise SettingsError(f'{name} must be {_KINDS[kind]}, not {_shown(text)}') from None
    return check_value(name, kind, description, value)


def text_table(settings_class: type) -> str:
    """Return the settings as lines for a terminal: name, type, default, then meaning."""
    lines = []
    for name, (kind, default, description) in describe(settings_class).items():
        shown = repr(default) if kind is str else str(default).lower()
        accepted = f'; {description.accepted}' if description.accepted else ''
        lines.append(f'  {name} ({kind.__name__}, {shown}{accepted})')
        lines.extend(textwrap.wrap(
            description.text, 95, initial_indent=' ' * 6, subsequent_indent=' ' * 6))
    return ''.join(f'{line}\n' for line in lines)


def markdown_table(settings_class: type) -> str:
    """Return the settings as a Markdown table for the documentation."""
    lines = ['| name | type | default | accepted | meaning |', '|---|---|---|---|---|']
    for name, (kind, default, description) in describe(settings_class).items():
        accepted = description.accepted.replace('|', '/')
        shown = f'`{default}`' if default != '' else "`''`"
        lines.append(f'| `{name}` | {kind.__name__} | {shown} | {accepted} | {description.text} |')
    return '\n'.join(lines)
