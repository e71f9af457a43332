# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The instrument panel at the bottom of the picture: bars for speed and wheels, and the score."""

from gymnasium.envs.box2d.car_dynamics import Car
from gymnasium.envs.box2d.car_racing import WINDOW_H
from gymnasium.envs.box2d.car_racing import WINDOW_W
import numpy as np
import pygame

_COLUMN = WINDOW_W / 40.0
_ROW = WINDOW_H / 40.0
_SHOWN = 1e-4
_FONT_SIZE = 42
_SCORE_CENTRE = (60, WINDOW_H - WINDOW_H * 2.5 / 40.0)
_KEPT_SCORES = 4096

BAR_COLOURS = np.array(
    [0xFFFFFF, 0x0000FF, 0x0000FF, 0x3300FF, 0x3300FF, 0x00FF00, 0xFF0000], np.uint32
)
"""Speed, the four wheels, steering, turning."""

NO_BAR = (0, -1, 0, -1)
"""A bar without any pixel."""


def bars(car: Car, speed: float) -> list[tuple[int, int, int, int]]:
    """
    Return first and last pixel, first and last row of the seven bars.

    Args:
        car: The car.
        speed: Speed of its hull, units per second.
    """
    wheels = car.wheels
    return [
        _upright(5, speed, 0.02),
        _upright(7, wheels[0].omega, 0.01),
        _upright(8, wheels[1].omega, 0.01),
        _upright(9, wheels[2].omega, 0.01),
        _upright(10, wheels[3].omega, 0.01),
        _level(20, wheels[0].joint.angle, -10.0),
        _level(30, car.hull.angularVelocity, -0.8),
    ]


def _upright(place: int, value: float, scale: float) -> tuple[int, int, int, int]:
    """Return the bar that grows from the bottom of the panel."""
    if abs(value) <= _SHOWN:
        return NO_BAR
    foot = int(WINDOW_H - _ROW)
    head = int(WINDOW_H - (_ROW + _ROW * (scale * value)))
    return (
        int(place * _COLUMN),
        int((place + 1) * _COLUMN),
        min(foot, head),
        max(foot, head),
    )


def _level(place: int, value: float, scale: float) -> tuple[int, int, int, int]:
    """Return the bar that grows to either side."""
    if abs(value) <= _SHOWN:
        return NO_BAR
    start = int(place * _COLUMN)
    end = int((place + scale * value) * _COLUMN)
    return (
        min(start, end),
        max(start, end),
        int(WINDOW_H - 4 * _ROW),
        int(WINDOW_H - 2 * _ROW),
    )


class ScoreText:
    """The score as pygame's default font draws it, each text drawn once and kept."""

    def __init__(self) -> None:
        """Open the font."""
        pygame.font.init()
        self._font = pygame.font.Font(pygame.font.get_default_font(), _FONT_SIZE)
        self._kept: dict[str, tuple[np.ndarray, int, int]] = {}

    def draw(self, score: float) -> tuple[np.ndarray, int, int]:
        """
        Return the pixels of `score`, uint32 (height, width), and where their first one goes.

        Returns:
            The pixels as 0xRRGGBB, the first pixel of a row, and the first row from the top.
        """
        text = f'{score:04.0f}'
        drawn = self._kept.get(text)
        if drawn is None:
            if len(self._kept) >= _KEPT_SCORES:
                self._kept.clear()
            drawn = self._kept[text] = self._draw(text)
        return drawn

    def _draw(self, text: str) -> tuple[np.ndarray, int, int]:
        """Let pygame draw `text`."""
        glyphs = self._font.render(text, True, (255, 255, 255), (0, 0, 0))
        place = glyphs.get_rect()
        place.center = _SCORE_CENTRE
        surface = pygame.Surface(glyphs.get_size(), depth=32)
        surface.blit(glyphs, (0, 0))
        rgb = pygame.surfarray.array3d(surface).astype(np.uint32)
        packed = rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2]
        return np.ascontiguousarray(packed.T), place.x, place.y
