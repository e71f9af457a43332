# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The polygons of the car, where they lie in the picture."""

from math import cos
from math import sin

from gymnasium.envs.box2d.car_dynamics import SIZE
from gymnasium.envs.box2d.car_dynamics import WHEEL_R
from gymnasium.envs.box2d.car_dynamics import WHEEL_W
from gymnasium.envs.box2d.car_dynamics import WHEEL_WHITE
from gymnasium.envs.box2d.car_dynamics import Car
import numpy as np

from msgs_bridge.compiled import compiled
from carracing_sim_node.edges import MAX_CORNERS
from carracing_sim_node.scanline import COSINE
from carracing_sim_node.scanline import SHIFT_X
from carracing_sim_node.scanline import SHIFT_Y
from carracing_sim_node.scanline import SINE
from carracing_sim_node.scanline import ZOOM
from carracing_sim_node.track_geometry import pack_rgb

_TREAD = 1.2
"""Angle of a wheel, in radians, that its white stripe takes."""


@compiled
def place_polygons(local, body_of, bodies, view, xs, ys):
    """
    Move polygons from their bodies to whole pixels of the picture.

    Box2D moves a corner to the world in single precision; pygame turns it in double precision.

    Args:
        local: float32 (m, MAX_CORNERS, 2): corners in the body.
        body_of: int64 (m,): the body of each polygon.
        bodies: float32 (5, 4): x, y, sine and cosine of each body.
        view: float64 (VIEW_SIZE,).
        xs: int64 (m, MAX_CORNERS), written.
        ys: int64 (m, MAX_CORNERS), written.
    """
    for i in range(local.shape[0]):
        body = bodies[body_of[i]]
        for k in range(local.shape[1]):
            # Each product and sum of two float32 is a float32 here, as it is in Box2D.
            x = body[3] * local[i, k, 0] - body[2] * local[i, k, 1]
            y = body[2] * local[i, k, 0] + body[3] * local[i, k, 1]
            world_x = np.float64(x + body[0])
            world_y = np.float64(y + body[1])
            turned_x = view[COSINE] * world_x - view[SINE] * world_y
            turned_y = view[SINE] * world_x + view[COSINE] * world_y
            xs[i, k] = np.int64(turned_x * view[ZOOM] + view[SHIFT_X])
            ys[i, k] = np.int64(turned_y * view[ZOOM] + view[SHIFT_Y])


class CarShape:
    """
    The twelve polygons of a car: each wheel with its stripe, then the four of the hull.

    Attributes:
        xs: int64 (12, MAX_CORNERS): corners in whole pixels, y from the bottom of the picture.
        ys: int64 (12, MAX_CORNERS).
        corners: int64 (12,): how many corners each polygon has, 0 if it does not show.
        colours: uint32 (12,): 0xRRGGBB.
    """

    def __init__(self, car: Car) -> None:
        """Take the shapes of `car`; every car has the same."""
        polygons = []
        for body, owner in enumerate(car.drawlist):
            colour = pack_rgb(channel * 255 for channel in owner.color)
            for fixture in owner.fixtures:
                polygons.append((body, fixture.shape.vertices, colour))
                if 'phase' in owner.__dict__:
                    polygons.append((body, [(0.0, 0.0)] * 4, pack_rgb(WHEEL_WHITE)))
        count = len(polygons)
        self._local = np.zeros((count, MAX_CORNERS, 2), np.float32)
        self._body_of = np.zeros(count, np.int64)
        self.colours = np.zeros(count, np.uint32)
        self.corners = np.zeros(count, np.int64)
        self.xs = np.zeros((count, MAX_CORNERS), np.int64)
        self.ys = np.zeros((count, MAX_CORNERS), np.int64)
        for i, (body, vertices, colour) in enumerate(polygons):
            self._local[i, : len(vertices)] = vertices
            self._body_of[i] = body
            self.corners[i] = len(vertices)
            self.colours[i] = colour
        self._stripe_x = np.array([-1, 1, 1, -1]) * (WHEEL_W * SIZE)

    def place(self, car: Car, view: np.ndarray) -> None:
        """Put the polygons where `car` shows them in `view`, float64 (VIEW_SIZE,)."""
        bodies = []
        for body in car.drawlist:
            transform = body.transform
            position = transform.position
            rotation = transform.q
            bodies.append((position.x, position.y, rotation.s, rotation.c))
        for i, wheel in enumerate(car.wheels):
            self._place_stripe(2 * i + 1, wheel.phase)
        place_polygons(
            self._local, self._body_of, np.array(bodies, np.float32), view, self.xs, self.ys
        )

    def _place_stripe(self, polygon: int, phase: float) -> None:
        """Turn the stripe of a wheel to its angle, or hide it on the far side."""
        sine_1 = sin(phase)
        sine_2 = sin(phase + _TREAD)
        if sine_1 > 0 and sine_2 > 0:
            self.corners[polygon] = 0
            return
        cosine_1 = cos(phase)
        cosine_2 = cos(phase + _TREAD)
        if sine_1 > 0:
            cosine_1 = (cosine_1 > 0) - (cosine_1 < 0)
        if sine_2 > 0:
            cosine_2 = (cosine_2 > 0) - (cosine_2 < 0)
        self.corners[polygon] = 4
        stripe = self._local[polygon]
        stripe[:4, 0] = self._stripe_x
        stripe[0, 1] = stripe[1, 1] = WHEEL_R * cosine_1 * SIZE
        stripe[2, 1] = stripe[3, 1] = WHEEL_R * cosine_2 * SIZE
