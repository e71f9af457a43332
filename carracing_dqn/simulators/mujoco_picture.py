# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo imported where it can draw, and its pictures, without a screen."""
from __future__ import annotations

import ctypes.util
import os
from types import ModuleType
from typing import Any

from msgs_bridge.errors import SimulatorError
from msgs_bridge.plain_text import plain
import numpy as np

INSTALL = "pip install 'carracing_dqn[mujoco]' (or pip install mujoco)"
MEND = 'pip install --force-reinstall mujoco'
LIBRARIES = 'apt-get install libegl1 libgl1-mesa-dri, or libosmesa6 and MUJOCO_GL=osmesa'
# nothing of ours casts a shadow, and what is not there takes a third of the time
LEFT_OUT = ('SHADOW', 'REFLECTION', 'HAZE')


def load_mujoco() -> ModuleType:
    """
    Import MuJoCo, and say what it draws by unless somebody has.

    Raises:
        SimulatorError: it or a library is missing; the line says how to install it.
    """
    if not os.environ.get('MUJOCO_GL'):
        # no window is opened, and nobody may answer at the screen that DISPLAY names
        kind = next((kind for kind, library in (('egl', 'EGL'), ('osmesa', 'OSMesa'))
                     if ctypes.util.find_library(library)), None)
        if kind is not None:
            os.environ['MUJOCO_GL'] = kind
        elif not os.environ.get('DISPLAY'):
            raise cannot_draw('no OpenGL')
    # Mesa in software: to share so few pixels among threads costs more than to draw them
    os.environ.setdefault('LP_NUM_THREADS', '0')
    try:
        import mujoco
        _ = mujoco.GLContext
    except ModuleNotFoundError as error:
        raise SimulatorError(f'{error.name} is not installed: {INSTALL}') from None
    except ImportError as error:
        # parts of different versions, for one, which no library of the system mends
        raise SimulatorError(f'MuJoCo cannot be loaded ({plain(error)}): {MEND}; to draw: '
                             f'{LIBRARIES}') from None
    except Exception as error:
        # OpenGL's loader fails in many ways where its library is missing
        raise cannot_draw(error) from None
    return mujoco


def cannot_draw(reason: object) -> SimulatorError:
    """Return the one line for a machine where nothing can be drawn."""
    return SimulatorError(f'MuJoCo cannot draw here ({plain(reason)}): {LIBRARIES}')


class Pictures:
    """Draws one world after the other; what all of them share is made once."""

    def __init__(self, mujoco: ModuleType, width: int, height: int) -> None:
        """
        Prepare pictures of a size.

        Raises:
            SimulatorError: it cannot draw here.
        """
        self._mujoco = mujoco
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._options, self._nothing = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._context = self._scene = None
        try:
            self._device = mujoco.GLContext(width, height)
            self._device.make_current()
        except Exception as error:
            raise cannot_draw(error) from None

    def show(self, model: Any) -> None:
        """Draw a world from now on."""
        mujoco = self._mujoco
        self._device.make_current()
        if self._context is not None:
            self._context.free()
            self._context = None
        try:
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:
            # a device that was there in name alone
            raise cannot_draw(error) from None
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(model, model.ngeom + 100)
        for name in LEFT_OUT:
            self._scene.flags[getattr(mujoco.mjtRndFlag, f'mjRND_{name}')] = 0

    def draw(self, model: Any, data: Any, camera: Any) -> np.ndarray:
        """Return what a camera sees, uint8 (height, width, 3)."""
        mujoco, rectangle = self._mujoco, self._rectangle
        # another simulator of this process may have drawn meanwhile
        self._device.make_current()
        mujoco.mjv_updateScene(model, data, self._options, self._nothing, camera,
                               mujoco.mjtCatBit.mjCAT_ALL.value, self._scene)
        mujoco.mjr_render(rectangle, self._scene, self._context)
        pixels = np.empty((rectangle.height, rectangle.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, rectangle, self._context)
        # OpenGL's rows go up
        return np.ascontiguousarray(pixels[::-1])

    def close(self) -> None:
        """Let go of the graphics memory."""
        if self._device is not None:
            self._device.make_current()
            if self._context is not None:
                self._context.free()
            self._device.free()
            self._context = self._device = None
