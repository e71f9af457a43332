# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A part of a picture, and a picture in another size."""
from __future__ import annotations

from typing import NamedTuple

from PIL import Image
import numpy as np

from msgs_bridge.errors import BridgeError, MessageError, SettingsError
from msgs_bridge.images import MAX_SIDE


class Crop(NamedTuple):
    """A part of a picture in pixels: left column, top row, width, height."""

    left: int
    top: int
    width: int
    height: int


def parse_crop(
    name: str, text: str, error: type[BridgeError] = SettingsError,
) -> Crop | None:
    """Read LEFT,TOP,WIDTH,HEIGHT of a setting; None for an empty text; raises an error."""
    if not text.strip():
        return None
    try:
        crop = Crop(*map(int, text.split(',')))
    except (TypeError, ValueError):
        raise error(
            f'{name} is {text[:40]!r}; accepted: LEFT,TOP,WIDTH,HEIGHT in pixels') from None
    if min(crop) < 0 or not (crop.width and crop.height) or max(crop) > MAX_SIDE:
        raise error(f'{name} is {text[:40]!r}; accepted: sides of 1 to {MAX_SIDE}')
    return crop


def cropped(
    name: str, pixels: np.ndarray, crop: Crop, error: type[BridgeError] = MessageError,
) -> np.ndarray:
    """
    Return a part of pixels (H, W, ...), without a copy.

    Args:
        name: of the setting that says which, for the error.
        pixels: the picture.
        crop: the part.
        error: what is raised when it does not fit on the picture.
    """
    height, width = pixels.shape[:2]
    if crop.left + crop.width > width or crop.top + crop.height > height:
        raise error(
            f'{name} {",".join(map(str, crop))} does not fit on an image of {width}x{height}')
    return pixels[crop.top:crop.top + crop.height, crop.left:crop.left + crop.width]


def resized(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return uint8 pixels (H, W, 3) in another size, averaged by area: no line gets lost."""
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    return np.asarray(picture.resize((width, height), Image.Resampling.BOX))
