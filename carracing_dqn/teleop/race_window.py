# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The window of a race, by pygame: the picture, figures beside it, keys and joysticks."""
from __future__ import annotations

import contextlib
import os
import sys

from carracing_dqn.teleop.hand import DOWN, HeldKeys, Joystick, LEFT, RIGHT, UP
from carracing_dqn.teleop.race import View
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
import numpy as np
import pygame

KEYS = {
    pygame.K_UP: UP, pygame.K_w: UP, pygame.K_DOWN: DOWN, pygame.K_s: DOWN,
    pygame.K_LEFT: LEFT, pygame.K_a: LEFT, pygame.K_RIGHT: RIGHT, pygame.K_d: RIGHT,
}
SCREENS = {'WAYLAND_DISPLAY': 'wayland', 'DISPLAY': 'x11'}
DRIVER = 'SDL_VIDEODRIVER'
HELP = 'arrows or W A S D, or a joystick; Esc ends'
PANEL, LEAST_HEIGHT = 400, 400
MARGIN, LINE = 20, 30
COLUMNS = (0, 110, 240)
BACKGROUND, TEXT, FAINT, BRIGHT = (24, 26, 30), (235, 235, 235), (150, 155, 165), (255, 214, 90)
# most pixels a side that a picture takes in the window
LARGEST = 4096
# of a picture before the first one has come
FIRST_SIZE = (96, 96)


class ScreenError(BridgeError):
    """There is no screen to open a window on."""


def check_screen() -> None:
    """Raise ScreenError where no window can be opened."""
    if sys.platform == 'linux' and not os.environ.get(DRIVER):
        there = [driver for name, driver in SCREENS.items() if os.environ.get(name)]
        if not there:
            raise ScreenError(f'no screen for a window: {" or ".join(SCREENS)} names one; '
                              'teleop_node drives in a terminal')
        # left to itself SDL draws into the air where no screen answers
        os.environ[DRIVER] = ','.join(there)
    try:
        pygame.display.init()
    except pygame.error as error:
        raise ScreenError(f'no screen for a window: {plain(error)}; teleop_node drives in a '
                          'terminal') from None


class RaceWindow:
    """Opens with the first `show`, and says what keys and joysticks do."""

    def __init__(self, scale: int, title: str) -> None:
        """
        Open the window.

        Args:
            scale: size of a pixel of the picture.
            title: of the window.

        Raises:
            ScreenError: there is no screen.
        """
        check_screen()
        pygame.font.init()
        pygame.joystick.init()
        self._scale = scale
        self._small, self._normal, self._large = (
            pygame.font.Font(None, size) for size in (22, 28, 44))
        self._sticks: dict[int, pygame.joystick.JoystickType] = {}
        self._shown: tuple[int, View] | None = None
        self._open(FIRST_SIZE)
        pygame.display.set_caption(title)

    def _open(self, size: tuple[int, int]) -> None:
        # whoever publishes images says how large they are, up to 4096 a side
        scale = min(self._scale, LARGEST / max(size))
        height, width = (max(1, round(side * scale)) for side in size)
        self._size = size
        self._picture = pygame.Surface((size[1], size[0]))
        self._large_picture = pygame.Surface((width, height))
        try:
            self._screen = pygame.display.set_mode(
                (width + PANEL, max(height, LEAST_HEIGHT)))
        except pygame.error as error:
            raise ScreenError(f'no window of {width + PANEL}x{height}: {plain(error)}') from None

    def poll(self, keys: HeldKeys, joystick: Joystick, now: float) -> bool:
        """
        Take what has happened; return whether the window is to be closed.

        Args:
            keys: told of keys that are pressed and let go.
            joystick: told of each joystick that is there, as `joy_node` of ROS would.
            now: time in s.

        Raises:
            MessageError: a joystick lacks an axis or a button.
        """
        for event in pygame.event.get():
            if event.type == pygame.QUIT or (
                    event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                return True
            if event.type == pygame.KEYDOWN and event.key in KEYS:
                keys.press(KEYS[event.key])
            elif event.type == pygame.KEYUP and event.key in KEYS:
                keys.release(KEYS[event.key])
            elif event.type == pygame.WINDOWFOCUSLOST:
                # what is let go meanwhile is not heard of
                keys.release_all()
            elif event.type in (pygame.WINDOWEXPOSED, pygame.WINDOWFOCUSGAINED):
                self._shown = None
            elif event.type == pygame.JOYDEVICEADDED:
                # it may have been pulled out again by now
                with contextlib.suppress(pygame.error):
                    stick = pygame.joystick.Joystick(event.device_index)
                    self._sticks[stick.get_instance_id()] = stick
            elif event.type == pygame.JOYDEVICEREMOVED:
                self._sticks.pop(event.instance_id, None)
        for stick in self._sticks.values():
            joystick.take([-stick.get_axis(axis) for axis in range(stick.get_numaxes())],
                          [stick.get_button(one) for one in range(stick.get_numbuttons())], now)
        return False

    def show(self, pixels: np.ndarray | None, stamp: int, view: View) -> None:
        """Draw a picture, uint8 (H, W, 3) rgb or None before the first, if anything is new."""
        if (stamp, view) == self._shown:
            return
        self._shown = stamp, view
        if pixels is not None and pixels.shape[:2] != self._size:
            self._open(pixels.shape[:2])
        self._screen.fill(BACKGROUND)
        if pixels is not None:
            pygame.surfarray.blit_array(self._picture, pixels.swapaxes(0, 1))
            pygame.transform.scale(
                self._picture, self._large_picture.get_size(), self._large_picture)
            self._screen.blit(self._large_picture, (0, 0))
        self._draw_panel(view)
        if view.call:
            self._draw_call(view.call)
        pygame.display.flip()

    def _draw_panel(self, view: View) -> None:
        left, top = self._large_picture.get_width() + MARGIN, MARGIN
        self._write(self._normal, view.title, BRIGHT, left, top)
        top += LINE + LINE // 2
        for row in view.rows:
            for text, column, colour in zip(row, COLUMNS, (FAINT, TEXT, FAINT)):
                self._write(self._normal, text, colour, left + column, top)
            top += LINE
        top += LINE // 2
        for line in view.results:
            self._write(self._small, line, TEXT, left, top)
            top += LINE
        self._write(self._small, HELP, FAINT, left, self._screen.get_height() - MARGIN - LINE // 2)

    def _draw_call(self, text: str) -> None:
        drawn = self._large.render(text, True, BRIGHT, BACKGROUND)
        self._screen.blit(drawn, drawn.get_rect(
            center=(self._large_picture.get_width() // 2, self._large_picture.get_height() // 3)))

    def _write(
        self, font: pygame.font.Font, text: str, colour: tuple[int, int, int], left: int, top: int,
    ) -> None:
        self._screen.blit(font.render(text, True, colour), (left, top))

    def close(self) -> None:
        """Close the window."""
        pygame.display.quit()
