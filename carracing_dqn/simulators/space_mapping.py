# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
From a command to an action of a Gymnasium space, by a mapping in YAML.

Box: a list with one `{linear: a, angular: b, offset: c}` for each number of it, which becomes
a x linear + b x angular + c within the bounds, rounded where the numbers are whole; of a single
number the mapping alone.
Discrete: `{nearest: [[linear, angular], ...]}`, a command for each action; the nearest one counts.
MultiDiscrete, MultiBinary: a list with the mapping of a Discrete for each place.
Tuple: a list with the mapping of each part. Dict: the mapping of each part by its name.
"""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from gymnasium import spaces
from msgs_bridge.errors import SimulatorError
from msgs_bridge.twists import Command
import numpy as np

WEIGHTS = ('linear', 'angular', 'offset')
# whole numbers of a space are nearer to 0
BEYOND = 2.0**64

Encode = Callable[[Command], Any]


def action_encoder(space: spaces.Space, mapping: Any, where: str = 'action') -> Encode:
    """
    Return what makes an action of a space out of a command within [-1, 1].

    Args:
        space: the action space.
        mapping: as told above.
        where: what an error calls the mapping.

    Raises:
        SimulatorError: the mapping does not fit the space, or there is none for such a space.
    """
    if isinstance(space, spaces.Box):
        return _box(space, mapping, where)
    if isinstance(space, spaces.Discrete):
        return _discrete(int(space.n), int(space.start), mapping, where)
    if isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
        return _places(space, mapping, where)
    if isinstance(space, spaces.Tuple):
        _need_list(mapping, len(space), where, space)
        parts = [action_encoder(one, mapping[number], f'{where}[{number}]')
                 for number, one in enumerate(space)]
        return lambda command: tuple(part(command) for part in parts)
    if isinstance(space, spaces.Dict):
        if not isinstance(mapping, dict) or set(mapping) != set(space):
            raise SimulatorError(f'{where} must map {", ".join(map(str, space))}, the parts of '
                                 f'{_shown(space)}')
        named = {name: action_encoder(one, mapping[name], f'{where}.{name}')
                 for name, one in space.items()}
        return lambda command: {name: part(command) for name, part in named.items()}
    raise SimulatorError(f'{where}: no command can be made an action of {_shown(space)}')


def _box(space: spaces.Box, mapping: Any, where: str) -> Encode:
    if isinstance(mapping, dict) and math.prod(space.shape) == 1:
        mapping = [mapping]
    _need_list(mapping, math.prod(space.shape), where, space)
    weights = np.array([_weights(one, f'{where}[{number}]')
                        for number, one in enumerate(mapping)]).reshape(-1, len(WEIGHTS))

    def encode(command: Command) -> np.ndarray:
        values = weights @ (command.linear, command.angular, 1.0)
        return np.clip(values.reshape(space.shape), space.low, space.high).astype(space.dtype)

    # as Python's, because bounds of 64 bits are no numbers of a float
    lows, highs = space.low.ravel().tolist(), space.high.ravel().tolist()

    def encode_whole(command: Command) -> np.ndarray:
        values = np.clip(weights @ (command.linear, command.angular, 1.0), -BEYOND, BEYOND)
        whole = [min(max(round(value), low), high)
                 for value, low, high in zip(values.tolist(), lows, highs)]
        return np.array(whole, space.dtype).reshape(space.shape)

    return encode_whole if np.issubdtype(space.dtype, np.integer) else encode


def _weights(mapping: Any, where: str) -> list[float]:
    if not isinstance(mapping, dict) or not set(mapping) <= set(WEIGHTS):
        raise SimulatorError(f'{where} must be a mapping of {", ".join(WEIGHTS)} to numbers')
    values = [mapping.get(name, 0.0) for name in WEIGHTS]
    if not all(type(one) in (int, float) and math.isfinite(one) for one in values):
        raise SimulatorError(f'{where} must map {", ".join(WEIGHTS)} to finite numbers')
    return values


def _discrete(count: int, start: int, mapping: Any, where: str) -> Encode:
    table = mapping.get('nearest') if isinstance(mapping, dict) and len(mapping) == 1 else None
    if not isinstance(table, list) or len(table) != count:
        raise SimulatorError(f'{where} must be nearest: and a list of {count} commands '
                             '[linear, angular], one for each action')
    try:
        commands = np.array(table, np.float64)
    except (TypeError, ValueError):
        commands = np.empty(0)
    if commands.shape != (count, 2) or not np.isfinite(commands).all():
        raise SimulatorError(f'{where}: each command must be [linear, angular], two numbers')
    return lambda command: start + int(((commands - command) ** 2).sum(1).argmin())


def _places(space: Any, mapping: Any, where: str) -> Encode:
    counts = (space.nvec if isinstance(space, spaces.MultiDiscrete)
              else np.full(space.shape, 2)).reshape(-1)
    starts = np.broadcast_to(getattr(space, 'start', 0), space.shape).reshape(-1)
    _need_list(mapping, len(counts), where, space)
    parts = [_discrete(int(count), int(start), one, f'{where}[{number}]')
             for number, (count, start, one) in enumerate(zip(counts, starts, mapping))]
    return lambda command: np.array(
        [part(command) for part in parts], space.dtype).reshape(space.shape)


def _need_list(mapping: Any, count: int, where: str, space: spaces.Space) -> None:
    if not isinstance(mapping, list) or len(mapping) != count:
        raise SimulatorError(
            f'{where} must be a list of {count}, one for each part of {_shown(space)}')


def _shown(space: spaces.Space) -> str:
    return ' '.join(str(space).split())[:100]
