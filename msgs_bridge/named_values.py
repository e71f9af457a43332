# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/JointState as a bundle of named numbers with one stamp."""
from __future__ import annotations

from collections.abc import Iterable
import math

from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import set_stamp
from msgs_bridge.step import check_names


def fill_named_values(message: object, values: dict[str, float], stamp: int) -> object:
    """Fill a JointState with names and positions at a stamp in ns; return it."""
    set_stamp(message.header.stamp, stamp)
    message.name = list(values)
    message.position = list(map(float, values.values()))
    return message


def read_named_values(message: object, required: Iterable[str] = ()) -> dict[str, float]:
    """
    Return name -> value of a JointState bundle.

    Raises:
        MessageError: names and positions of different length, too many names, one that is too
            long or there twice, a required name that is missing, or a required value that is
            not finite.
    """
    if len(message.name) != len(message.position):
        raise MessageError(
            f'bundle has {len(message.name)} names but {len(message.position)} values')
    check_names('bundle', message.name)
    values = dict(zip(message.name, message.position))
    if len(values) != len(message.name):
        raise MessageError('bundle has a name twice')
    for name in required:
        if name not in values:
            raise MessageError(f'bundle lacks {name!r}')
        if not math.isfinite(values[name]):
            raise MessageError(f'{name} is {values[name]}')
    return values
