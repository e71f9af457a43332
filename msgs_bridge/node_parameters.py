# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A settings class as the parameters of a node: declared, checked and with ranges.

Which names have to be known: all on the command line and in those sections of a parameter file
that name this node alone. A section for several nodes (`/**` and others with a `*`) may hold what
belongs to others; what this node does not know of it is logged and left out.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import dataclasses
from pathlib import Path
from typing import Any

from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import check_value, describe, Description, unknown_setting
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

# declared by rclpy itself, or by it on our behalf
FOREIGN_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')

Known = Mapping[str, tuple[type, Any, Description]]


def declare_settings(
    node: Node, settings_classes: Sequence[type], arguments: Sequence[str],
) -> list[Any]:
    """
    Declare the parameters of a node and return its settings, one object a class.

    Args:
        node: nothing may be declared on it yet but what rclpy declares.
        settings_classes: made with `setting()`; their names do not meet.
        arguments: the command line of the process, to tell what was typed from what a file says.

    Raises:
        SettingsError: a parameter that is unknown or not accepted.
    """
    known = {name: entry for one in settings_classes for name, entry in describe(one).items()}
    typed = dict(_typed(arguments))
    _refuse_unknown(node, known, typed, arguments)
    values = {}
    for name, (kind, default, description) in known.items():
        given = node._parameter_overrides.get(name)
        if given is not None:
            value = _as_meant(kind, given, typed.get(name))
            check_value(name, kind, description, value)
            node._parameter_overrides[name] = Parameter(name, value=value)
        try:
            values[name] = node.declare_parameter(
                name, default, _descriptor(kind, description)).value
        except (ParameterException, InvalidParameterTypeException) as error:
            raise SettingsError(f'{name}: {plain(error)}') from None
    return [one(**{field.name: values[field.name] for field in dataclasses.fields(one)})
            for one in settings_classes]


def _descriptor(kind: type, description: Description) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=description.text, additional_constraints=description.accepted,
        read_only=not description.live)
    if description.low is not None:
        limits = {'from_value': kind(description.low), 'to_value': kind(description.high)}
        if kind is int:
            descriptor.integer_range = [IntegerRange(**limits)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(**limits)]
    return descriptor


def _as_meant(kind: type, given: Parameter, typed: str | None) -> Any:
    """Return a value as its setting means it: ROS reads 2026 as a number, whatever it names."""
    value = given.value
    if kind is float and given.type_ == Parameter.Type.INTEGER:
        return float(value)
    if kind is str and type(value) in (int, float, bool):
        if typed is not None:
            return typed
        return str(value).lower() if type(value) is bool else f'{value:.17g}'
    return value


def _refuse_unknown(
    node: Node, known: Known, typed: Mapping[str, str], arguments: Sequence[str],
) -> None:
    unknown = [name for name in node._parameter_overrides
               if name not in known and name.partition('.')[0] not in FOREIGN_PARAMETERS]
    if not unknown:
        return
    shared = set(_shared_names(arguments, node.get_name()))
    for name in unknown:
        problem = unknown_setting(name, known)
        if name in typed or name not in shared:
            raise SettingsError(problem)
        node.get_logger().warn(f'{problem} (from a section for several nodes: left out)')


def _after(arguments: Sequence[str], *options: str) -> Iterator[str]:
    """Return what follows options among the arguments for ROS."""
    inside = False
    for place, argument in enumerate(arguments):
        if argument in ('--ros-args', '--'):
            inside = argument == '--ros-args'
        elif inside and argument in options and place + 1 < len(arguments):
            yield arguments[place + 1]


def _typed(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Return name and text of the parameters on the command line."""
    for assignment in _after(arguments, '-p', '--param'):
        name, separator, text = assignment.partition(':=')
        if separator:
            # a rule may be for one node only: NODE:NAME:=VALUE
            yield name.rpartition(':')[2], text


def _shared_names(arguments: Sequence[str], node_name: str) -> Iterator[str]:
    """Return the names that parameter files give only in sections that do not name this node."""
    shared: set[str] = set()
    own: set[str] = set()
    for path in _after(arguments, '--params-file'):
        try:
            sections = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
        except (OSError, ValueError, yaml.YAMLError):
            # ROS has read it; what we cannot read is held to the stricter rule
            continue
        for node, name in _names(sections):
            ours = '*' not in node and node.rpartition('/')[2] == node_name
            (own if ours else shared).add(name)
    yield from shared - own


def _names(sections: Any, path: str = '') -> Iterator[tuple[str, str]]:
    """Return node and parameter name of what stands in a parameter file."""
    if not isinstance(sections, dict):
        return
    for key, value in sections.items():
        if key == 'ros__parameters':
            yield from ((path, name) for name in _flat(value))
        else:
            yield from _names(value, f'{path}/{str(key).strip("/")}')


def _flat(values: Any, prefix: str = '') -> Iterator[str]:
    if not isinstance(values, dict):
        return
    for key, value in values.items():
        yield from (_flat(value, f'{prefix}{key}.') if isinstance(value, dict)
                    else [f'{prefix}{key}'])
