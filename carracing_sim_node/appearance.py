# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What CarRacing looks and steers like, for other worlds that are to look and steer like it.

Colours, sizes and the car are read off gymnasium's own objects, and drawn by this package's loops.
"""
from __future__ import annotations

import math

from carracing_sim_node.car_shape import CarShape
from carracing_sim_node.fast_renderer import warm_up
from carracing_sim_node.panel import BAR_COLOURS, bars, ScoreText
from carracing_sim_node.scanline import draw_frame, make_scratch, OUT, PANEL_ROWS
from carracing_sim_node.simulation import Simulation
from carracing_sim_node.track_geometry import pack_rgb
from gymnasium.envs.box2d.car_dynamics import Car, SIZE, WHEELPOS
from gymnasium.envs.box2d.car_racing import (
    GRASS_DIM, PLAYFIELD, SCALE, WINDOW_H, WINDOW_W, ZOOM,
)
import numpy as np

# of the view once the first second's zoom is over
_ZOOM = ZOOM * SCALE
PIXELS_PER_UNIT = OUT / WINDOW_W * _ZOOM
"""Pixels of the observation, from left to right, to a unit of the world."""

STRETCH = WINDOW_H / WINDOW_W
"""Length that a pixel shows from top to bottom, as a share of that from left to right."""

CAR_ROW = OUT * 3 // 4
"""The car's centre is between this row and the one above it, and in the middle across."""

PANEL_ROW = OUT - PANEL_ROWS * OUT // WINDOW_H
"""First row of the instrument panel."""

# of the hinges of the front wheels, and of the motors that turn them (Box2D): rad, rad/s, 1/s
_LOCK, _TURNING, _STIFFNESS = 0.4, 3.0, 50.0
# from the front axle to the rear one, in units
_WHEELBASE = SIZE * (max(y for _, y in WHEELPOS) - min(y for _, y in WHEELPOS))


class Palette:
    """
    The colours of the ground, uint8 rgb.

    Attributes:
        field, grass: the two greens.
    """

    def __init__(self) -> None:
        """Read them off a world of gymnasium."""
        world = Simulation()
        self.field = world.bg_color.astype(np.uint8)
        self.grass = world.grass_color.astype(np.uint8)
        world.close()


def grass_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return whether the lighter green covers some places, in units."""
    across, up = (np.floor(place / GRASS_DIM).astype(int) % 2 == 0 for place in (x, y))
    return across & up


class CarAndPanel:
    """Draws CarRacing's car and instrument panel over pictures of 96x96 pixels."""

    def __init__(self) -> None:
        """Put a car into an empty world."""
        warm_up()
        self._world = Simulation()
        self._car = Car(self._world.world, 0.0, 0.0, 0.0)
        self._shape = CarShape(self._car)
        self._score = ScoreText()
        self._scratch = make_scratch(1)
        self._behind = pack_rgb(self._world.road_color)
        self._view = np.array([1.0, 0.0, _ZOOM, WINDOW_W / 2, WINDOW_H / 4, 0.0, 0.0])

    def draw(
        self, pixels: np.ndarray, *, speed: float, driven: float, steering: float, turning: float,
        score: float,
    ) -> None:
        """
        Draw over a picture.

        Args:
            pixels: uint8 (96, 96, 3), changed.
            speed: forward, units/s.
            driven: way driven so far, by which the wheels have turned, units.
            steering: angle of the front wheels, left positive, rad.
            turning: rate of the car, left positive, rad/s.
            score: what the panel says.
        """
        car = self._car
        car.hull.angularVelocity = turning
        for number, wheel in enumerate(car.wheels):
            wheel.omega = speed / wheel.wheel_rad
            wheel.phase = driven / wheel.wheel_rad
            wheel.angle = steering if number < 2 else 0.0
        self._shape.place(car, self._view)
        text, text_x, text_y = self._score.draw(score)
        drawn = np.empty((OUT, OUT, 3), np.uint8)
        draw_frame(
            np.zeros((1, 4, 2)), np.zeros((1, 3)), np.zeros(1, np.uint32), self._view,
            self._behind, PLAYFIELD, self._shape.xs, self._shape.ys, self._shape.corners,
            self._shape.colours, np.array(bars(car, abs(speed))), BAR_COLOURS, text, text_x,
            text_y, self._scratch, drawn)
        # the picture of a car on nothing but road; where it shows, it covers
        covered = (drawn != drawn[0, 0]).any(axis=2)
        covered[PANEL_ROW:] = True
        pixels[covered] = drawn[covered]

    def close(self) -> None:
        """Let go of the world."""
        self._world.close()


class SteeringColumn:
    """
    The front wheels' angle, which follows the steering command at a limited rate.

    Attributes:
        angle: left positive, rad.
    """

    def __init__(self) -> None:
        """Begin straight."""
        self.angle = 0.0

    def turn(self, wanted: float, seconds: float) -> float:
        """
        Turn towards a command within [-1, 1] for some time; return the angle.

        CarRacing takes the command for radians, of which the hinge allows 0.4.
        """
        error = wanted - self.angle
        rate = math.copysign(min(_STIFFNESS * abs(error), _TURNING), error)
        self.angle = min(max(self.angle + rate * seconds, -_LOCK), _LOCK)
        return self.angle

    def turning(self, speed: float) -> float:
        """Return how fast wheels that do not slide turn a car of some units/s, rad/s."""
        return speed * math.tan(self.angle) / _WHEELBASE
