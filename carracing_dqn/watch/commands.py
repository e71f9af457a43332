# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What can be done from a watch, by name, and whom it asks for it."""
from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TYPE_CHECKING

from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain

if TYPE_CHECKING:
    from carracing_dqn.watch.state import WatchState


class Call(NamedTuple):
    """A service to call: a 'switch' (SetBool), 'trigger' (Trigger) or 'parameter' of a node."""

    kind: str
    service: str
    name: str = ''
    value: Any = None


class Commands(dict):
    """Name of a command -> (kind of its value, lowest, highest); None for one without."""

    def check(self, name: str, value: Any) -> None:
        """Raise SettingsError for a command that there is not, or a value that is none for it."""
        if name not in self:
            raise SettingsError(f'no command {plain(name)!r}; there are {", ".join(self)}')
        wanted = self[name]
        if wanted is None:
            return
        kind, low, high = wanted
        if kind is bool:
            good = isinstance(value, bool)
        else:
            good = type(value) in (int, float) and low <= value <= high
        if not good:
            raise SettingsError(f'{name}: {plain(value)!r} is not accepted; '
                                + ('true or false' if kind is bool else f'{low:g} to {high:g}'))


COMMANDS = Commands(
    pause=(bool, 0, 1), step=None, reset=None, enable=(bool, 0, 1), epsilon=(float, 0.0, 1.0))
"""What a live graph offers."""

BAG_COMMANDS = Commands(
    pause=(bool, 0, 1), step=None, seek=(float, 0.0, 1e9), skip=(float, -1e9, 1e9),
    rate=(float, 0.01, 100.0))
"""What a bag offers."""


def calls(
    name: str, value: Any, state: WatchState, namespace: str | None,
) -> Iterator[Call]:
    """Yield whom to ask for a command in the namespace of a car; None: in every one."""
    for service in sorted(state.services):
        node, _, base = service.rpartition('/')
        if namespace is not None and node.rpartition('/')[0] != namespace:
            continue
        if name in ('pause', 'enable') and base == name:
            yield Call('switch', service, value=value)
        elif name in ('step', 'reset') and base == name:
            yield Call('trigger', service)
        elif name == 'epsilon' and base == 'enable' and f'{node}/set_parameters' in state.services:
            yield Call('parameter', f'{node}/set_parameters', 'epsilon', float(value))
