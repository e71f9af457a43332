# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Images of a bag as arrays, as fast as the disk and the compression allow."""
from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bags.topic_lookup import need_topic
from bags.decode import decode_image
from bags.errors import BagError
from bags.reader import BagReader
from msgs_bridge.topics import COMPRESSED_TYPE, IMAGE


def bag_images(
    reader: BagReader, *, topic: str | None = None, namespace: str = '',
) -> Iterator[tuple[int, np.ndarray]]:
    """
    Yield stamp in ns and pixels, uint8 (H, W, 3) rgb, of every image in order of log time.

    The array is a view that holds on to about a megabyte of the bag: copy what is kept.

    Args:
        reader: the bag.
        topic: full name; None = the car's images.
        namespace: where the car's images are; needed if there are several.

    Raises:
        BagError: there is no such topic, or the bag is damaged.
        MessageError: an image that cannot be used.
    """
    name = topic or need_topic(reader, IMAGE, namespace=namespace)
    messages = reader.messages([name])
    type_name = reader.topics[name].type_name
    if type_name not in (IMAGE.type_name, COMPRESSED_TYPE):
        raise BagError(f'{name} is of type {type_name}; expected {IMAGE.type_name}')
    for message in messages:
        yield decode_image(message.data, name, type_name)


def load_images(
    reader: BagReader, *, topic: str | None = None, namespace: str = '',
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return all images of a topic: stamps, int64 (N,) in ns, and pixels, uint8 (N, H, W, 3).

    Raises:
        BagError: no such topic, images of different sizes, more than memory holds, or a damaged
            bag.
        MessageError: an image that cannot be used.
    """
    name = topic or need_topic(reader, IMAGE, namespace=namespace)
    count = reader.topics[name].message_count if name in reader.topics else 0
    stamps = np.zeros(0, np.int64)
    frames = np.zeros((0, 0, 0, 3), np.uint8)
    number = 0
    for stamp, pixels in bag_images(reader, topic=name):
        if number == 0:
            # the count comes from the file: what it promises is allocated but not yet touched
            try:
                stamps = np.empty(count, np.int64)
                frames = np.empty((count, *pixels.shape), np.uint8)
            except (ValueError, MemoryError):
                raise BagError(f'{name}: {count} images of {pixels.shape[1]}x{pixels.shape[0]} '
                               'do not fit into memory') from None
        if pixels.shape != frames.shape[1:]:
            raise BagError(f'{name}: image {number} is {pixels.shape[1]}x{pixels.shape[0]}, '
                           f'those before are {frames.shape[2]}x{frames.shape[1]}')
        if number == count:
            raise BagError(f'{name} holds more images than the file says')
        stamps[number] = stamp
        frames[number] = pixels
        number += 1
    return stamps[:number], frames[:number]
