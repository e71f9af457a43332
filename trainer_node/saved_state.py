# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a checkpoint holds beside arrays: dataclasses as JSON, checked by type when they come back.

A field may be an `int` (a count: whole and not negative), a `float` (finite), a `bool`, a `str`,
`Seconds` (finite and not negative), a `Stamp` (ns, as far as ROS can say), another such dataclass,
any of them `| None`, a `list[...]` or `dict[str, ...]` of them, or `dict[str, Any]` for what
somebody else will check. A field with a default may be missing: it is younger than the checkpoint.
"""
from __future__ import annotations

import dataclasses
import sys
import types
from typing import Annotated, Any, get_args, get_origin, get_type_hints, TypeVar, Union

from msgs_bridge.step import MAX_WHOLE
from trainer_node.errors import RunError

Kind = TypeVar('Kind')
Seconds = Annotated[float, 'seconds']
Stamp = Annotated[int, 'ns']
# the seconds of a stamp are an int32, its nanoseconds a uint32, and nobody refuses odd ones
MAX_STAMP = 2**31 * 10**9 + 2**32


def from_json(kind: type[Kind], values: Any, path: str) -> Kind:
    """
    Return a dataclass made of JSON values that are not trusted.

    Args:
        kind: the dataclass.
        values: what `dataclasses.asdict` gave once.
        path: how the text of an error names it.

    Raises:
        RunError: a field is missing, unknown, or not of its type.
    """
    if not isinstance(values, dict):
        raise RunError(f'{path} is {_shown(values)}; expected a mapping')
    hints = get_type_hints(kind, include_extras=True)
    needed = {field.name for field in dataclasses.fields(kind)
              if field.default is field.default_factory is dataclasses.MISSING}
    for problem, names in (
        ('lacks', needed - values.keys()), ('has unknown', values.keys() - hints.keys()),
    ):
        if names:
            raise RunError(f'{path} {problem} {sorted(names)[0]!r}'[:200])
    return kind(**{name: _checked(hint, values[name], f'{path}.{name}')
                   for name, hint in hints.items() if name in values})


def _checked(hint: Any, value: Any, path: str) -> Any:
    """Return a value if it is what a type hint says; raises RunError."""
    if get_origin(hint) in (Union, types.UnionType):
        if value is None:
            return None
        hint = next(each for each in get_args(hint) if each is not types.NoneType)
    if dataclasses.is_dataclass(hint):
        return from_json(hint, value, path)
    if get_origin(hint) is list and type(value) is list:
        return [_checked(get_args(hint)[0], each, f'{path}[{index}]')
                for index, each in enumerate(value)]
    if get_origin(hint) is dict and type(value) is dict:
        inner = get_args(hint)[1]
        if inner is Any:
            return value
        return {name: _checked(inner, each, f'{path}.{name}') for name, each in value.items()}
    if hint is int and type(value) is int and 0 <= value <= MAX_WHOLE:
        return value
    if hint == Stamp and type(value) is int and abs(value) <= MAX_STAMP:
        return value
    if hint in (float, Seconds) and is_finite(value) and (hint is float or value >= 0):
        return value
    if hint in (bool, str) and type(value) is hint:
        return value
    raise RunError(f'{path[:200]} is {_shown(value)}; expected {_in_words(hint)}')


def is_finite(value: Any) -> bool:
    """Return whether a JSON value is a number that a float can be."""
    # comparing takes any int, where math.isfinite raises
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _in_words(hint: Any) -> str:
    return {
        int: 'a whole number from 0', float: 'a finite number', Seconds: 'seconds from 0',
        bool: 'true or false', str: 'a text', Stamp: 'a stamp in ns',
    }.get(hint) or ('a list' if get_origin(hint) is list else 'a mapping')


def _shown(value: Any) -> str:
    """Return a value as an error shows it: short, whatever it is."""
    return repr(value) if isinstance(value, (int, float, bool, type(None))) and (
        not isinstance(value, int) or abs(value) < 1e18) else f'a {type(value).__name__}'
