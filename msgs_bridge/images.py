# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/Image <-> rgb array, with every claim of the message checked."""
from __future__ import annotations

import numpy as np

from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import set_stamp

# A car's camera is small; a larger claim is a mistake or an attack.
MAX_SIDE = 4096
# channel order of the encodings that are understood
RGB_CHANNELS = {'rgb8': (0, 1, 2), 'bgr8': (2, 1, 0), 'rgba8': (0, 1, 2), 'bgra8': (2, 1, 0)}
CHANNELS = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4}


def image_to_array(message: object) -> np.ndarray:
    """
    Return the pixels of an Image as a read-only rgb array, uint8 (H, W, 3).

    rgb8 is a view on the message's buffer; other encodings are copied.

    Raises:
        MessageError: unknown encoding, a size of 0 or above 4096, a row step that is too short,
            or data that is not as long as height and step say.
    """
    encoding, height, width, step = message.encoding, message.height, message.width, message.step
    if encoding not in CHANNELS:
        raise MessageError(f'image encoding {encoding!r}; accepted: {", ".join(CHANNELS)}')
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
        raise MessageError(f'image of {width}x{height}; accepted: 1 to {MAX_SIDE} a side')
    channels = CHANNELS[encoding]
    if step < width * channels:
        raise MessageError(f'image step {step} is shorter than a row of {width * channels} bytes')
    data = np.frombuffer(message.data, np.uint8)
    if data.size != height * step:
        raise MessageError(f'image has {data.size} bytes; its header says {height * step}')
    pixels = data.reshape(height, step)[:, :width * channels].reshape(height, width, channels)
    if encoding != 'rgb8':
        pixels = np.ascontiguousarray(pixels[:, :, list(RGB_CHANNELS[encoding])])
    return pixels


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
