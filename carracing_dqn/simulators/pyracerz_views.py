# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a car of pyRacerz sees from above, its nose up: as the game draws it, or as CarRacing does.

The second is made of each pixel alone, by its colour and its place in the picture; it knows
nothing of where the road goes.
"""
from __future__ import annotations

import math
from typing import Any

from PIL import Image, ImageFilter
from carracing_sim_node.appearance import (
    CAR_ROW, CarAndPanel, grass_at, Palette, PIXELS_PER_UNIT,
)
import numpy as np
import pygame

SIDE = 96
# a pixel whose channels differ by more than this share of the largest one is no road
SATURATION = 0.25
# the picture of the car whose nose is up, of the 256 the game has made
NOSE_UP = 64


class TopView:
    """Turned sections of a picture, averaged over the pixels that one of theirs shows."""

    def __init__(self, picture: np.ndarray, scale: float, stretch: float,
                 beyond: tuple[int, ...]) -> None:
        """
        Take a picture.

        Args:
            picture: uint8 (H, W, 3).
            scale: pixels of it to one of the section, across.
            stretch: the same from top to bottom, as a share of that.
            beyond: colour of what lies outside.
        """
        average = ImageFilter.BoxBlur(max(scale * (1 + stretch) / 4 - 0.5, 0))
        blurred = np.asarray(Image.fromarray(picture).filter(average))
        self._source = np.full((blurred.shape[0] + 2, blurred.shape[1] + 2, 3), beyond, np.uint8)
        self._source[1:-1, 1:-1] = blurred
        places = np.arange(SIDE) + 0.5
        self._right = (places - SIDE / 2)[None, :] * scale
        self._ahead = (CAR_ROW - places)[:, None] * scale * stretch

    def look(self, x: float, y: float, angle: float) -> np.ndarray:
        """Return the section around a place, an array of its own."""
        # the game's heading is (-cos, -sin)
        cosine, sine = math.cos(angle), math.sin(angle)
        columns = x - cosine * self._ahead + sine * self._right
        rows = y - sine * self._ahead - cosine * self._right
        height, width, _ = self._source.shape
        return self._source[
            np.clip(np.floor(rows) + 1, 0, height - 1).astype(np.intp),
            np.clip(np.floor(columns) + 1, 0, width - 1).astype(np.intp)]


def _pixels_of(surface: pygame.Surface) -> np.ndarray:
    return np.ascontiguousarray(pygame.surfarray.array3d(surface).swapaxes(0, 1))


class RawView:
    """The game's own colours and car."""

    def __init__(self, track: pygame.Surface, car: Any, scale: float, stretch: float) -> None:
        """Take the picture of the track and the car that is in the middle."""
        self._car = car
        self._view = TopView(_pixels_of(track), scale, stretch, (0, 0, 0))
        size = [max(round(side / by), 1) for side, by in (
            (car.sizeRect, scale), (car.sizeRect, scale * stretch))]
        left, top = SIDE // 2 - size[0] // 2, CAR_ROW - size[1] // 2
        # a car that is seen from near reaches beyond the picture
        columns = slice(max(left, 0), min(left + size[0], SIDE))
        rows = slice(max(top, 0), min(top + size[1], SIDE))
        self._place = rows, columns
        part = (slice(rows.start - top, rows.stop - top),
                slice(columns.start - left, columns.stop - left))
        self._sprites = [tuple(layer[part] for layer in self._sprite(pictures[NOSE_UP], size))
                         for pictures in (car.cars, car.cars2)]

    @staticmethod
    def _sprite(picture: pygame.Surface, size: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return colours, multiplied by opacity, and transparency of a picture made smaller."""
        opacity = pygame.surfarray.array_alpha(picture).T[..., None] / 255
        layers = np.concatenate((_pixels_of(picture) * opacity, opacity), axis=2)
        small = np.stack([
            np.asarray(Image.fromarray(layer.astype(np.float32)).resize(
                size, Image.Resampling.BOX)) for layer in np.moveaxis(layers, 2, 0)], axis=2)
        return small[..., :3], 1 - small[..., 3:]

    def draw(self, **_: float) -> np.ndarray:
        """Return the picture, uint8 (96, 96, 3)."""
        car = self._car
        pixels = self._view.look(car.x, car.y, car.angle)
        colours, transparency = self._sprites[car.brake > 0]
        pixels[self._place] = colours + transparency * pixels[self._place]
        return pixels

    def close(self) -> None:
        """Let go of nothing."""


class CarRacingView:
    """The track's picture in CarRacing's colours, with CarRacing's car and panel."""

    def __init__(self, track: pygame.Surface, car: Any, scale: float, stretch: float,
                 road_level: int) -> None:
        """Take the picture of the track and the car that is in the middle."""
        self._car = car
        # pixels of the track to a unit of CarRacing's world
        self._unit = scale * PIXELS_PER_UNIT
        palette = Palette()
        self._view = TopView(recoloured(_pixels_of(track), self._unit, palette, road_level),
                             scale, stretch, tuple(palette.field))
        self._overlay = CarAndPanel()

    def draw(self, *, driven: float, steering: float, turning: float, score: float) -> np.ndarray:
        """
        Return the picture, uint8 (96, 96, 3).

        Args:
            driven: way driven, pixels of the track.
            steering: angle of the front wheels, left positive, rad.
            turning: rate of the car, left positive, rad/s.
            score: what the panel says.
        """
        car = self._car
        pixels = self._view.look(car.x, car.y, car.angle)
        # the game's speed is in pixels a step of 1/100 s
        self._overlay.draw(
            pixels, speed=car.speed * 100 / self._unit, driven=driven / self._unit,
            steering=steering, turning=turning, score=score)
        return pixels

    def close(self) -> None:
        """Let go of the car."""
        self._overlay.close()


def recoloured(
    pixels: np.ndarray, unit: float, palette: Palette, road_level: int,
) -> np.ndarray:
    """
    Return a picture in CarRacing's colours: what is about gray as road, all else as grass.

    Args:
        pixels: uint8 (H, W, 3).
        unit: pixels to a unit of CarRacing's world.
        palette: CarRacing's.
        road_level: gray level of the road.
    """
    rows, columns = np.indices(pixels.shape[:2]) / unit
    result = np.where(grass_at(columns, rows)[..., None], palette.grass, palette.field)
    channels = pixels.astype(int)
    most = channels.max(axis=2)
    result[most - channels.min(axis=2) <= SATURATION * most] = road_level
    return result
