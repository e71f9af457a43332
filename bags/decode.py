# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized messages -> objects with the fields of the message, without ROS."""
from __future__ import annotations

from collections.abc import Iterable
import functools
import struct
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from bags.errors import BagError
from msgs_bridge.images import image_to_array
from msgs_bridge.named_values import read_named_values
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds

# little-endian CDR, the only kind that machines of our day write
LITTLE_ENDIAN = b'\x00\x01'
STAMP = struct.Struct('<iI')
COUNT = struct.Struct('<I')
# A CDR stream is aligned from behind its 4 bytes of encapsulation.
ORIGIN = 4


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


class BundleDecoder:
    """
    Decodes JointState bundles, quickly when the names stay the same from one to the next.

    A bundle of 26 names takes 35 us to decode; when everything up to the values equals the
    bundle before, only stamp and values are read.
    """

    def __init__(self) -> None:
        self._middle = b''
        self._names: tuple[str, ...] = ()
        self._values = struct.Struct('<')
        self._offset = 0
        self._end = 0

    def decode(self, data: Any, what: str) -> Bundle:
        """
        Return a bundle; `what` names it in errors.

        Raises:
            BagError: the bytes are not a JointState.
        """
        if (len(data) >= self._end > 0 and data[12:self._offset] == self._middle
                and data[:2] == LITTLE_ENDIAN):
            seconds, nanoseconds = STAMP.unpack_from(data, ORIGIN)
            return Bundle(seconds * NANOSECONDS + nanoseconds, self._names,
                          self._values.unpack_from(data, self._offset))
        message = decode(data, 'sensor_msgs/msg/JointState', what)
        names, values = tuple(message.name), tuple(message.position.tolist())
        if data[:2] == LITTLE_ENDIAN:
            self._remember(data, names, len(values))
        stamp = message.header.stamp
        return Bundle(stamp.sec * NANOSECONDS + stamp.nanosec, names, values)

    def _remember(self, data: Any, names: tuple[str, ...], count: int) -> None:
        """Note where the values begin in a bundle that has decoded well."""
        position = _skip_string(data, 12)
        position = _aligned(position, 4) + COUNT.size
        for _ in names:
            position = _skip_string(data, _aligned(position, 4))
        position = _aligned(_aligned(position, 4) + COUNT.size, 8)
        if not count or position + 8 * count > len(data):
            return
        self._names = names
        self._offset = position
        self._middle = bytes(data[12:position])
        self._values = struct.Struct(f'<{count}d')
        self._end = position + self._values.size


class ImageDecoder:
    """
    Decodes images into arrays, quickly when only stamp and pixels change from one to the next.

    Everything between stamp and pixels - frame, size, encoding, row step, length - is checked
    once; an image in which those bytes are the same needs no second look.
    """

    def __init__(self) -> None:
        self._middle = b''
        self._offset = 0
        self._end = 0
        self._shape = (0, 0, 0)

    def decode(self, data: Any, what: str) -> tuple[int, np.ndarray]:
        """
        Return stamp in ns and pixels, uint8 (H, W, 3) rgb, read-only; `what` names it in errors.

        Raises:
            BagError: the bytes are not an Image.
            MessageError: an image that cannot be used.
        """
        if (len(data) >= self._end > 0 and data[12:self._offset] == self._middle
                and data[:2] == LITTLE_ENDIAN):
            seconds, nanoseconds = STAMP.unpack_from(data, ORIGIN)
            pixels = np.frombuffer(data, np.uint8, self._end - self._offset, self._offset)
            return seconds * NANOSECONDS + nanoseconds, pixels.reshape(self._shape)
        message = decode(data, 'sensor_msgs/msg/Image', what)
        pixels = image_to_array(message)
        if data[:2] == LITTLE_ENDIAN and message.encoding == 'rgb8' and pixels.size == len(
                message.data):
            self._remember(data, pixels)
        return to_nanoseconds(message.header.stamp), pixels

    def _remember(self, data: Any, pixels: np.ndarray) -> None:
        """Note where the pixels begin in an image that is good."""
        # frame_id, height and width, encoding, is_bigendian, step, length of the data
        position = _aligned(_skip_string(data, 12), 4) + 8
        position = _aligned(_skip_string(data, position) + 1, 4) + 8
        self._offset = position
        self._middle = bytes(data[12:position])
        self._end = position + pixels.size
        self._shape = pixels.shape


def _aligned(position: int, size: int) -> int:
    return position + (ORIGIN - position) % size


def _skip_string(data: Any, position: int) -> int:
    return position + COUNT.size + COUNT.unpack_from(data, position)[0]
