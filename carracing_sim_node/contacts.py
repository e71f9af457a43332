# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What happens when the car begins or ends to touch a road tile."""

from typing import Any

from gymnasium.envs.box2d.car_racing import FrictionDetector

from carracing_sim_node.progress import TileProgress


class WatchedContacts(FrictionDetector):
    """Gymnasium's `FrictionDetector`, with `progress` kept beside it."""

    def __init__(self, sim: Any, lap_complete_percent: float) -> None:
        """Watch the world of `sim`, whose track has just been created."""
        super().__init__(sim, lap_complete_percent)
        self.progress = TileProgress(len(sim.track))

    def BeginContact(self, contact: Any) -> None:  # noqa: N802 (Box2D calls it by this name)
        """Let gymnasium handle the contact, then move along the lap."""
        super().BeginContact(contact)
        tile, wheel = tile_and_other(contact)
        if tile is not None and wheel is not None:
            self.progress.touch(tile.idx)


class TileContacts(FrictionDetector):
    """
    Gymnasium's `FrictionDetector` with the same effects and less work.

    A touched tile takes the plain road colour (once: it never changes back), a wheel knows the
    tiles under it, and a tile that a wheel touches for the first time is paid. Beside that it
    keeps `progress`, and tells the renderer of a changed colour through `sim.tile_faded`.
    """

    def __init__(self, sim: Any, lap_complete_percent: float) -> None:
        """Watch the world of `sim`, whose track has just been created."""
        super().__init__(sim, lap_complete_percent)
        self.progress = TileProgress(len(sim.track))
        self._plain = bytearray(len(sim.track))

    def BeginContact(self, contact: Any) -> None:  # noqa: N802
        """Put the tile under the wheel; pay it if it is new."""
        tile, wheel = self._faded(contact)
        if wheel is None:
            return
        wheel.tiles.add(tile)
        self.progress.touch(tile.idx)
        if not tile.road_visited:
            sim = self.env
            tile.road_visited = True
            sim.reward += 1000.0 / len(sim.track)
            sim.tile_visited_count += 1
            if (
                tile.idx == 0
                and sim.tile_visited_count / len(sim.track) > self.lap_complete_percent
            ):
                sim.new_lap = True

    def EndContact(self, contact: Any) -> None:  # noqa: N802
        """Take the tile from under the wheel."""
        tile, wheel = self._faded(contact)
        if wheel is not None:
            wheel.tiles.discard(tile)

    def _faded(self, contact: Any) -> tuple[Any, Any]:
        """Return what `tile_and_other` does, with the tile in the plain road colour."""
        tile, wheel = tile_and_other(contact)
        if tile is not None and not self._plain[tile.idx]:
            self._plain[tile.idx] = 1
            tile.color[:] = self.env.road_color
            self.env.tile_faded(tile.idx)
        return tile, wheel


def tile_and_other(contact: Any) -> tuple[Any, Any]:
    """
    Return the two that touch: the tile, and the wheel on it or None for the hull.

    Without a tile both are None.
    """
    tile = contact.fixtureA.body.userData
    other = contact.fixtureB.body.userData
    if tile is None or 'road_friction' not in tile.__dict__:
        tile, other = other, tile
        if tile is None or 'road_friction' not in tile.__dict__:
            return None, None
    return tile, other
