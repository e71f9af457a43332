# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Creates the road tiles of a track in Box2D, as gymnasium's `_create_track` does."""

from typing import Any

from Box2D.b2 import bodyDef
from Box2D.b2 import staticBody

from carracing_sim_node.track_layout import START_ALPHA
from carracing_sim_node.track_layout import TrackLayout

_BORDER_COLOURS = ((255, 255, 255), (255, 0, 0))


def create_tiles(sim: Any, layout: TrackLayout) -> None:
    """
    Give `sim`, gymnasium's CarRacing, everything that a track consists of.

    Args:
        sim: Its `road`, `road_poly`, `track` and `start_alpha` are set, and tiles are created in
            its `world`.
        layout: Where the track lies.
    """
    definition = bodyDef(type=staticBody)
    world = sim.world
    fixture_definition = sim.fd_tile
    shades = [sim.road_color + 0.01 * shade * 255 for shade in range(3)]
    sim.start_alpha = START_ALPHA
    sim.road = []
    borders = layout.borders.tolist()
    bordered = layout.bordered.tolist()
    for i, corners in enumerate(layout.tiles.tolist()):
        fixture_definition.shape.vertices = corners
        tile = world.CreateBody(definition)
        tile.CreateFixture(fixture_definition).sensor = True
        tile.userData = tile
        tile.color = shades[i % 3].copy()
        tile.road_visited = False
        tile.road_friction = 1.0
        tile.idx = i
        sim.road_poly.append((corners, tile.color))
        sim.road.append(tile)
        if bordered[i]:
            sim.road_poly.append((borders[i], _BORDER_COLOURS[i % 2]))
    sim.track = [tuple(point) for point in layout.middle.tolist()]
