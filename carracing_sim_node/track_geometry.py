# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The field, the grass and the road of an episode as arrays, in gymnasium's drawing order."""

from collections.abc import Iterable

from gymnasium.envs.box2d.car_racing import GRASS_DIM
from gymnasium.envs.box2d.car_racing import PLAYFIELD
import numpy as np

from carracing_sim_node.simulation import Simulation


def pack_rgb(colour: Iterable[float]) -> int:
    """Return a colour of three numbers, each cut to a whole one, as 0xRRGGBB."""
    red, green, blue = (int(value) for value in colour)
    return red << 16 | green << 8 | blue


def _ground() -> np.ndarray:
    """Return the corners of the field and of the grass patches, float64 (401, 4, 2)."""
    b = PLAYFIELD
    d = GRASS_DIM
    quads = [[(b, b), (b, -b), (-b, -b), (-b, b)]]
    for x in range(-20, 20, 2):
        for y in range(-20, 20, 2):
            quads.append(
                [
                    (d * x + d, d * y + 0),
                    (d * x + 0, d * y + 0),
                    (d * x + 0, d * y + d),
                    (d * x + d, d * y + d),
                ]
            )
    return np.array(quads)


_GROUND = _ground()


class TrackGeometry:
    """
    Everything of an episode that lies still.

    Attributes:
        quads: float64 (n, 4, 2), corners in the world.
        places: float64 (n, 3), centre and radius of each quad.
        colours: uint32 (n,), 0xRRGGBB.
        background: 0xRRGGBB of the field.
    """

    def __init__(self, sim: Simulation) -> None:
        """Take the track that `sim` has just created."""
        corners = [corner for polygon, _ in sim.road_poly for point in polygon for corner in point]
        road = np.array(corners, np.float64).reshape(-1, 4, 2)
        self.quads = np.concatenate((_GROUND, road))
        centres = self.quads.mean(axis=1)
        radii = np.sqrt(((self.quads - centres[:, None]) ** 2).sum(axis=2).max(axis=1))
        self.places = np.column_stack((centres, radii))

        self.background = pack_rgb(sim.bg_color)
        self.colours = np.empty(len(self.quads), np.uint32)
        self.colours[0] = self.background
        self.colours[1 : len(_GROUND)] = pack_rgb(sim.grass_color)
        self._road_colour = pack_rgb(sim.road_color)
        channels = np.array([colour for _, colour in sim.road_poly]).astype(np.uint32)
        road_colours = channels[:, 0] << 16 | channels[:, 1] << 8 | channels[:, 2]
        self.colours[len(_GROUND) :] = road_colours
        # A tile's polygon holds the tile's own colour array; a border's holds a tuple.
        self._quad_of_tile = [
            quad
            for quad, (_, colour) in enumerate(sim.road_poly, len(_GROUND))
            if not isinstance(colour, tuple)
        ]

    def fade_tile(self, index: int) -> None:
        """Give tile `index` the plain road colour."""
        self.colours[self._quad_of_tile[index]] = self._road_colour
