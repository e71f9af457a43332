# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The modules of pyRacerz where Debian installs them, without a window and out of our way."""
from __future__ import annotations

import configparser
import functools
import importlib
import os
from pathlib import Path
import sys
from types import SimpleNamespace

from msgs_bridge.errors import SimulatorError
from msgs_bridge.plain_text import plain
import pygame

# pyRacerz itself looks for its pictures there and nowhere else
FOLDER = Path('/usr/share/games/pyracerz/modules')
# in the order in which they need each other; their names are common ones
MODULES = ('misc', 'car', 'track', 'player')
INSTALL = 'install the package pyracerz of Debian or Ubuntu: apt-get install pyracerz'


class _Parser(configparser.ConfigParser):
    """A parser that still has the method that Python 3.12 took away."""

    def readfp(self, file: object) -> None:
        self.read_file(file)


def load_game() -> SimpleNamespace:
    """
    Return the modules of the game by name, ready to load a track.

    Raises:
        SimulatorError: it is not installed, or cannot be used.
    """
    game = _modules()
    # pictures are converted to the format of a display, which has to exist for that; another
    # simulator of this process may have closed the one that was there
    game.misc.screen = _display()
    return game


@functools.cache
def _modules() -> SimpleNamespace:
    if not FOLDER.is_dir():
        raise SimulatorError(f'pyRacerz is not here; {INSTALL}')
    before = {name: sys.modules.pop(name) for name in MODULES if name in sys.modules}
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    sys.path.insert(0, str(FOLDER))
    try:
        game = SimpleNamespace(**{name: importlib.import_module(name) for name in MODULES})
    except Exception as error:
        raise SimulatorError(f'pyRacerz in {FOLDER}: {type(error).__name__}: {plain(error)}'
                             ) from error
    finally:
        sys.path.remove(str(FOLDER))
        sys.dont_write_bytecode = writes
        for name in MODULES:
            sys.modules.pop(name, None)
        sys.modules.update(before)
    for module in (game.misc, game.track):
        module.configparser = SimpleNamespace(ConfigParser=_Parser)
    return game


def _display() -> pygame.Surface:
    """Return the surface of a display, one that nobody sees unless there is one already."""
    if pygame.display.get_surface() is not None:
        return pygame.display.get_surface()
    driver = os.environ.get('SDL_VIDEODRIVER')
    os.environ['SDL_VIDEODRIVER'] = 'dummy'
    try:
        pygame.display.init()
        return pygame.display.set_mode((1, 1))
    finally:
        if driver is None:
            del os.environ['SDL_VIDEODRIVER']
        else:
            os.environ['SDL_VIDEODRIVER'] = driver
