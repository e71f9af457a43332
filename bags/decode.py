# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized messages -> objects with the fields of the message, without ROS."""
from __future__ import annotations

from collections.abc import Iterable
import functools
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from bags.errors import BagError
from msgs_bridge.images import compressed_to_array, image_to_array
from msgs_bridge.named_values import read_named_values
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.topics import COMPRESSED_TYPE, IMAGE


class Bundle(NamedTuple):
    """A JointState: stamp in ns, names and values."""

    stamp: int
    name: tuple[str, ...]
    position: tuple[float, ...]

    def values_with(self, required: Iterable[str] = ()) -> dict[str, float]:
        """
        Return name -> value.

        Raises:
            MessageError: names and values differ in number, or a required one is missing.
        """
        return read_named_values(self, required)


@functools.cache
def typestore() -> Typestore:
    """Return the message types of Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def decode(data: Any, type_name: str, what: str) -> Any:
    """
    Return a message; `what` names it in errors.

    Raises:
        BagError: an unknown type, or bytes that are not a message of it.
    """
    try:
        return typestore().deserialize_cdr(data, type_name)
    except KeyError:
        raise BagError(f'{what}: the message type {type_name!r} is not known') from None
    except Exception as error:
        # the generated code raises whatever it ran into
        raise BagError(f'{what} is not a {type_name}: {error!r}') from None


def decode_bundle(data: Any, what: str) -> Bundle:
    """
    Return a bundle; `what` names it in errors.

    Raises:
        BagError: the bytes are not a JointState.
    """
    message = decode(data, 'sensor_msgs/msg/JointState', what)
    return Bundle(to_nanoseconds(message.header.stamp), tuple(message.name),
                  tuple(message.position.tolist()))


def decode_image(
    data: Any, what: str, type_name: str = IMAGE.type_name,
) -> tuple[int, np.ndarray]:
    """
    Return stamp in ns and pixels, uint8 (H, W, 3) rgb, read-only.

    Args:
        data: the message.
        what: names it in errors.
        type_name: its type, `topics.COMPRESSED_TYPE` for a compressed one.

    Raises:
        BagError: the bytes are not of that type.
        MessageError: an image that cannot be used.
    """
    message = decode(data, type_name, what)
    pixels = (compressed_to_array if type_name == COMPRESSED_TYPE else image_to_array)(message)
    return to_nanoseconds(message.header.stamp), pixels
