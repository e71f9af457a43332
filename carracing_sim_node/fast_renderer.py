# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled renderer of the observation."""

from functools import cache
import math

from gymnasium.envs.box2d.car_racing import PLAYFIELD
from gymnasium.envs.box2d.car_racing import SCALE
from gymnasium.envs.box2d.car_racing import STATE_H
from gymnasium.envs.box2d.car_racing import STATE_W
from gymnasium.envs.box2d.car_racing import WINDOW_H
from gymnasium.envs.box2d.car_racing import WINDOW_W
from gymnasium.envs.box2d.car_racing import ZOOM
import numpy as np

from carracing_sim_node.car_shape import CarShape
from carracing_sim_node.car_shape import place_polygons
from carracing_sim_node.edges import MAX_CORNERS
from carracing_sim_node.panel import BAR_COLOURS
from carracing_sim_node.panel import NO_BAR
from carracing_sim_node.panel import ScoreText
from carracing_sim_node.panel import bars
from carracing_sim_node.scanline import VIEW_SIZE
from carracing_sim_node.scanline import ZOOM as ZOOM_INDEX
from carracing_sim_node.scanline import draw_frame
from carracing_sim_node.scanline import make_scratch
from carracing_sim_node.simulation import Simulation
from carracing_sim_node.track_geometry import TrackGeometry

_RIGHT_ANGLE_SLACK = 1e-6
"""Within this angle of a quarter turn pygame turns by exactly that quarter turn."""

_QUARTER_TURNS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0))


def rotation(angle: float) -> tuple[float, float]:
    """Return cosine and sine with which pygame's `Vector2.rotate_rad` turns by `angle`."""
    angle = math.fmod(angle, 2.0 * math.pi)
    if angle < 0:
        angle += 2.0 * math.pi
    slack = _RIGHT_ANGLE_SLACK
    if math.fmod(angle + slack, math.pi / 2) < 2 * slack:
        return _QUARTER_TURNS[int((angle + slack) / (math.pi / 2))]
    return math.cos(angle), math.sin(angle)


class FastRenderer:
    """Draws what gymnasium draws, from the same physics, with compiled loops of its own."""

    name = 'fast'

    def __init__(self, sim: Simulation, *, settled_zoom: bool) -> None:
        """Draw the frames of `sim`; with `settled_zoom` without the first second's zoom."""
        self._sim = sim
        self._settled_zoom = settled_zoom
        self._score = ScoreText()
        self._view = np.zeros(VIEW_SIZE)
        self._geometry: TrackGeometry | None = None
        self._shape: CarShape | None = None
        self._scratch = make_scratch(0)
        self._capacity = 0
        sim.on_new_track = self._take_track
        sim.on_tile_faded = self._fade_tile
        warm_up()

    def draw(self) -> np.ndarray:
        """Return the present frame, uint8 (96, 96, 3), an array of its own."""
        sim = self._sim
        car = sim.car
        if self._shape is None:
            self._shape = CarShape(car)
        shape = self._shape
        geometry = self._geometry
        self._look(sim)
        shape.place(car, self._view)
        text, text_x, text_y = self._score.draw(sim.shown_reward)
        out = np.empty((STATE_H, STATE_W, 3), np.uint8)
        draw_frame(
            geometry.quads,
            geometry.places,
            geometry.colours,
            self._view,
            geometry.background,
            PLAYFIELD,
            shape.xs,
            shape.ys,
            shape.corners,
            shape.colours,
            np.array(bars(car, sim.speed)),
            BAR_COLOURS,
            text,
            text_x,
            text_y,
            self._scratch,
            out,
        )
        return out

    def _look(self, sim: Simulation) -> None:
        """Work out how the world lies in the picture."""
        hull = sim.car.hull
        position = hull.position
        x = position.x
        y = position.y
        time = max(sim.t, 1.0) if self._settled_zoom else sim.t
        zoom = 0.1 * SCALE * max(1 - time, 0) + ZOOM * SCALE * min(time, 1)
        cosine, sine = rotation(-hull.angle)
        scroll_x = -x * zoom
        scroll_y = -y * zoom
        self._view[:] = (
            cosine,
            sine,
            zoom,
            WINDOW_W / 2 + (cosine * scroll_x - sine * scroll_y),
            WINDOW_H / 4 + (sine * scroll_x + cosine * scroll_y),
            x,
            y,
        )

    def _take_track(self) -> None:
        """Take the geometry of a new episode."""
        self._geometry = TrackGeometry(self._sim)
        count = len(self._geometry.quads)
        if count > self._capacity:
            self._capacity = count + count // 4
            self._scratch = make_scratch(self._capacity)

    def _fade_tile(self, index: int) -> None:
        """Show that tile `index` has been touched."""
        self._geometry.fade_tile(index)


@cache
def warm_up() -> None:
    """
    Load or compile the loops now, so that no lap waits for them.

    Loading takes a fraction of a second; the first time ever, compiling takes some ten seconds.
    """
    view = np.zeros(VIEW_SIZE)
    view[ZOOM_INDEX] = 1.0
    xs = np.zeros((1, MAX_CORNERS), np.int64)
    place_polygons(
        np.zeros((1, MAX_CORNERS, 2), np.float32),
        np.zeros(1, np.int64),
        np.zeros((1, 4), np.float32),
        view,
        xs,
        xs.copy(),
    )
    draw_frame(
        np.zeros((1, 4, 2)),
        np.zeros((1, 3)),
        np.zeros(1, np.uint32),
        view,
        0,
        PLAYFIELD,
        xs,
        xs.copy(),
        np.zeros(1, np.int64),
        np.zeros(1, np.uint32),
        np.array([NO_BAR]),
        BAR_COLOURS,
        np.zeros((1, 1), np.uint32),
        0,
        0,
        make_scratch(1),
        np.empty((STATE_H, STATE_W, 3), np.uint8),
    )
