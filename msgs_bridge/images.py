# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs images <-> rgb arrays, with every claim of a message checked."""
from __future__ import annotations

import io
from typing import NamedTuple
import warnings

import numpy as np

from msgs_bridge.errors import MessageError
from msgs_bridge.plain_text import plain
from msgs_bridge.stamps import set_stamp

# What PIL thinks of a picture is a line on stderr for each that differs, and anybody may send
# many. `catch_warnings` is for one thread alone.
warnings.filterwarnings('ignore', module=r'PIL\.')

# A larger claim is a mistake or an attack.
MAX_SIDE = 4096
MAX_BYTES = 64 << 20


class Encoding(NamedTuple):
    """How many channels an encoding has, and where red, green and blue lie among them."""

    channels: int
    rgb: tuple[int, int, int]


ENCODINGS = {
    'rgb8': Encoding(3, (0, 1, 2)), 'bgr8': Encoding(3, (2, 1, 0)),
    'rgba8': Encoding(4, (0, 1, 2)), 'bgra8': Encoding(4, (2, 1, 0)),
    'mono8': Encoding(1, (0, 0, 0)), '8UC1': Encoding(1, (0, 0, 0)),
    # names no colours; OpenCV, which has the name, means blue, green, red
    '8UC3': Encoding(3, (2, 1, 0)),
}


def image_to_array(message: object, encoding: str = '') -> np.ndarray:
    """
    Return the pixels of an Image as a read-only rgb array, uint8 (H, W, 3).

    rgb8 is a view on the message's buffer; other encodings are copied.

    Args:
        message: a sensor_msgs/Image.
        encoding: taken in place of what the message says, for cameras that say it wrongly.

    Raises:
        MessageError: unknown encoding, a size of 0 or above 4096, a row step that is too short,
            or data that is not as long as height and step say.
    """
    encoding = encoding or message.encoding
    if encoding not in ENCODINGS:
        raise MessageError(
            f'image encoding {encoding[:40]!r}; accepted: {", ".join(ENCODINGS)}')
    height, width, step = message.height, message.width, message.step
    _check_size(width, height)
    channels, rgb = ENCODINGS[encoding]
    if step < width * channels:
        raise MessageError(f'image step {step} is shorter than a row of {width * channels} bytes')
    data = np.frombuffer(message.data, np.uint8)
    if data.size != height * step:
        raise MessageError(f'image has {data.size} bytes; its header says {height * step}')
    pixels = data.reshape(height, step)[:, :width * channels].reshape(height, width, channels)
    if (channels, rgb) != ENCODINGS['rgb8']:
        pixels = np.ascontiguousarray(pixels[:, :, list(rgb)])
    return pixels


def compressed_to_array(message: object) -> np.ndarray:
    """
    Return the pixels of a CompressedImage, jpeg or png, as an rgb array, uint8 (H, W, 3).

    Raises:
        MessageError: more than 64 MiB, a size of 0 or above 4096, or bytes that are neither; the
            size is looked at before anything is unpacked.
    """
    # only cameras that compress need it
    from PIL import Image, UnidentifiedImageError

    if len(message.data) > MAX_BYTES:
        raise MessageError(f'image of {len(message.data)} bytes; accepted: up to {MAX_BYTES}')
    try:
        with Image.open(io.BytesIO(bytes(message.data)), formats=('JPEG', 'PNG')) as picture:
            _check_size(*picture.size)
            return np.asarray(picture.convert('RGB'))
    except UnidentifiedImageError:
        raise MessageError('image is neither jpeg nor png') from None
    except MessageError:
        raise
    except Exception as error:
        # PIL raises whatever it ran into: an IndexError for a PNG with an empty chunk
        raise MessageError(f'image cannot be unpacked: {plain(error, 80)}') from None


def _check_size(width: int, height: int) -> None:
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
        raise MessageError(f'image of {width}x{height}; accepted: 1 to {MAX_SIDE} a side')


def fill_compressed_image(
    message: object, pixels: np.ndarray, stamp: int, frame_id: str,
) -> object:
    """Fill a CompressedImage with rgb pixels, uint8 (H, W, 3), as png: without loss; return it."""
    from PIL import Image

    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = frame_id
    message.format = 'png'
    packed = io.BytesIO()
    # the fastest level: the others save a tenth more, in twice the time
    Image.fromarray(pixels).save(packed, 'PNG', compress_level=1)
    message.data = packed.getvalue()
    return message


def fill_image(message: object, pixels: np.ndarray, stamp: int, frame_id: str) -> object:
    """Fill an Image with rgb pixels, uint8 (H, W, 3), at a stamp in ns; return it."""
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = frame_id
    message.height, message.width, _ = pixels.shape
    message.encoding = 'rgb8'
    message.is_bigendian = 0
    message.step = 3 * message.width
    # bytes are copied once; an array or a list would be copied element by element
    message.data = pixels.tobytes()
    return message
