# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From any camera's message to a frame of the size that a model learned from."""
from __future__ import annotations

import dataclasses

import numpy as np

from msgs_bridge.images import compressed_to_array, ENCODINGS, image_to_array
from msgs_bridge.picture_parts import cropped, parse_crop, resized
from msgs_bridge.settings import setting

TURNS = ('0', '90', '180', '270')


@dataclasses.dataclass(frozen=True)
class CameraSettings:
    """How a camera hangs and what of its image the model sees; by default all of it, as it is."""

    camera_compressed: bool = setting(
        False, 'true: image_raw is a CompressedImage, jpeg or png')
    camera_encoding: str = setting(
        '', 'encoding of the images, in place of what they say; empty: as they say',
        choices=('', *ENCODINGS))
    camera_crop: str = setting(
        '', 'part of the image to look at in pixels, LEFT,TOP,WIDTH,HEIGHT; empty: all of it')
    camera_turn: str = setting(
        '0', 'degrees to turn the part clockwise, so that ahead is up', choices=TURNS)
    camera_mirror: bool = setting(
        False, 'true: exchange left and right after turning, as a mirror in front of it does')


class Camera:
    """Makes frames of one size out of images of any."""

    def __init__(self, settings: CameraSettings, height: int, width: int) -> None:
        """
        Prepare frames of `height` rows and `width` columns.

        Raises:
            SettingsError: a crop that is no part of an image.
        """
        self._settings = settings
        self._crop = parse_crop('camera_crop', settings.camera_crop)
        self._quarter_turns = -(int(settings.camera_turn) // 90)
        self._shape = (height, width, 3)

    def frame(self, message: object) -> np.ndarray:
        """
        Return the frame of an image message, uint8 (height, width, 3) rgb.

        An image that needs nothing is handed on without a copy. Another size is averaged by area,
        so that no line gets lost; proportions are kept by choosing the crop.

        Raises:
            MessageError: an image that cannot be used, or that the crop does not fit on.
        """
        settings = self._settings
        if settings.camera_compressed:
            pixels = compressed_to_array(message)
            if settings.camera_encoding:
                pixels = pixels[:, :, list(ENCODINGS[settings.camera_encoding].rgb)]
        else:
            pixels = image_to_array(message, settings.camera_encoding)
        if self._crop is not None:
            pixels = cropped('camera_crop', pixels, self._crop)
        if self._quarter_turns:
            pixels = np.rot90(pixels, self._quarter_turns)
        if settings.camera_mirror:
            pixels = pixels[:, ::-1]
        if pixels.shape != self._shape:
            height, width, _ = self._shape
            pixels = resized(pixels, width, height)
        return pixels
