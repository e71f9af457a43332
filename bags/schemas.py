# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Message definitions and type hashes, read from the `share` folders of the message packages.

The text of a definition is what rosbag2 writes as schema encoding `ros2msg`: the root `.msg`
file, then every type it depends on, depth first, sorted, each once, below a line of 80 `=` and
`MSG: package/Type`.
"""
from __future__ import annotations

import dataclasses
import functools
import json
import re

from msgs_bridge.message_types import share_file

DELIMITER = '=' * 80
PRIMITIVES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))
# `type name`, `type[3] name`, `string<=10[<=5] name default`, `int32 CONSTANT=1`
FIELD = re.compile(r'^(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[(?:<=)?\d*\])?\s+[A-Za-z]')


@dataclasses.dataclass(frozen=True)
class Schema:
    """
    A message type as a bag names it.

    Attributes:
        type_name: `package/msg/Type`.
        encoding: `ros2msg`, or empty when the definition is not on this machine.
        text: the definition with everything it depends on.
        type_hash: the RIHS01 hash, or empty when it is not known.
    """

    type_name: str
    encoding: str
    text: str
    type_hash: str


@functools.cache
def schema_of(type_name: str) -> Schema:
    """Return the schema of `package/msg/Type`; encoding and text are empty if it is not found."""
    root = _definition(type_name)
    if root is None:
        return Schema(type_name, '', '', _type_hash(type_name))
    parts = [root]
    seen = {type_name}
    if not _append_dependencies(type_name, root, parts, seen):
        return Schema(type_name, '', '', _type_hash(type_name))
    return Schema(type_name, 'ros2msg', ''.join(parts), _type_hash(type_name))


def _append_dependencies(type_name: str, text: str, parts: list[str], seen: set[str]) -> bool:
    for written in sorted(_dependencies(type_name, text)):
        package, name = written.split('/')
        dependency = f'{package}/msg/{name}'
        if dependency in seen:
            continue
        seen.add(dependency)
        definition = _definition(dependency)
        if definition is None:
            return False
        parts.append(f'\n{DELIMITER}\nMSG: {written}\n{definition}')
        if not _append_dependencies(dependency, definition, parts, seen):
            return False
    return True


def _dependencies(type_name: str, text: str) -> set[str]:
    """Return the types a definition names, as `package/Type`."""
    found = set()
    for line in text.splitlines():
        match = FIELD.match(line.split('#', 1)[0].strip())
        if match is None or match['type'] in PRIMITIVES:
            continue
        parts = match['type'].split('/')
        if len(parts) == 1:
            # a bare Header is std_msgs' by old custom; any other bare name is of this package
            package = 'std_msgs' if parts == ['Header'] else type_name.split('/')[0]
            found.add(f'{package}/{parts[0]}')
        else:
            found.add(f'{parts[0]}/{parts[-1]}')
    return found


def _definition(type_name: str) -> str | None:
    return share_file(type_name, '.msg')


def _type_hash(type_name: str) -> str:
    text = share_file(type_name, '.json')
    if text is None:
        return ''
    try:
        return str(json.loads(text)['type_hashes'][0]['hash_string'])
    except (ValueError, LookupError, TypeError):
        return ''
