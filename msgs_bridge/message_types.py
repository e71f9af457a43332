# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Message types by the names that a wire or a file gives them, which nobody vouches for."""
from __future__ import annotations

from collections.abc import Iterator
import functools
import importlib
import os
from pathlib import Path
import re
import sys

from msgs_bridge.errors import MessageError

TYPE_NAME = re.compile(r'[a-z][a-z0-9_]{0,99}/msg/[A-Z][A-Za-z0-9]{0,99}')


@functools.cache
def message_class(type_name: str) -> type:
    """
    Return the message class of `package/msg/Type`.

    Nothing is imported before an installed message package is known to define the type: a name
    from outside chooses among those and no other modules.

    Raises:
        MessageError: no name of a message type, or one that is not installed here.
    """
    if share_file(type_name, '.msg') is None:
        raise MessageError(f'message type {type_name[:100]!r} is not installed here')
    package, kind, name = type_name.split('/')
    try:
        found = getattr(importlib.import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise MessageError(f'message type {type_name!r} is installed, but cannot be loaded: '
                           f'{error}') from None
    if not hasattr(found, 'get_fields_and_field_types'):
        raise MessageError(f'message type {type_name!r} is no message')
    return found


def share_file(type_name: str, suffix: str) -> str | None:
    """Return the text that an installed package keeps of a type, `.msg` or `.json`, or None."""
    if not TYPE_NAME.fullmatch(type_name):
        return None
    package, kind, name = type_name.split('/')
    for folder in _share_folders():
        try:
            return (folder / package / kind / f'{name}{suffix}').read_text(encoding='utf-8')
        except (OSError, UnicodeDecodeError):
            continue
    return None


def _share_folders() -> Iterator[Path]:
    """Yield where message packages may be installed: the ament prefixes, then this Python."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        if prefix:
            yield Path(prefix, 'share')
    yield Path(sys.prefix, 'share')
