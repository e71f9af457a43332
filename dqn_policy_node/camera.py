# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From any camera's message to a frame of the size that a model learned from."""
from __future__ import annotations

import dataclasses
from typing import NamedTuple

from PIL import Image
import numpy as np

from msgs_bridge.errors import MessageError, SettingsError
from msgs_bridge.images import compressed_to_array, ENCODINGS, image_to_array, MAX_SIDE
from msgs_bridge.settings import setting

TURNS = ('0', '90', '180', '270')


class Crop(NamedTuple):
    """A part of an image in pixels: left column, top row, width, height."""

    left: int
    top: int
    width: int
    height: int


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
        self._crop = parse_crop(settings.camera_crop)
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
            pixels = _cropped(pixels, self._crop)
        if self._quarter_turns:
            pixels = np.rot90(pixels, self._quarter_turns)
        if settings.camera_mirror:
            pixels = pixels[:, ::-1]
        if pixels.shape != self._shape:
            height, width, _ = self._shape
            picture = Image.fromarray(np.ascontiguousarray(pixels))
            pixels = np.asarray(picture.resize((width, height), Image.Resampling.BOX))
        return pixels


def parse_crop(text: str) -> Crop | None:
    """Read LEFT,TOP,WIDTH,HEIGHT; None for an empty text; raises SettingsError."""
    if not text.strip():
        return None
    try:
        crop = Crop(*map(int, text.split(',')))
    except (TypeError, ValueError):
        raise SettingsError(
            f'camera_crop is {text[:40]!r}; accepted: LEFT,TOP,WIDTH,HEIGHT in pixels') from None
    if min(crop) < 0 or not (crop.width and crop.height) or max(crop) > MAX_SIDE:
        raise SettingsError(f'camera_crop is {text[:40]!r}; accepted: sides of 1 to {MAX_SIDE}')
    return crop


def _cropped(pixels: np.ndarray, crop: Crop) -> np.ndarray:
    height, width, _ = pixels.shape
    if crop.left + crop.width > width or crop.top + crop.height > height:
        raise MessageError(
            f'camera_crop {",".join(map(str, crop))} does not fit on an image of {width}x{height}')
    return pixels[crop.top:crop.top + crop.height, crop.left:crop.left + crop.width]
