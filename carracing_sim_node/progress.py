# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Which tiles of the lap were visited, and which were left behind."""

from collections.abc import Iterable

PASSED_BEHIND = 3
"""
Tiles between the foremost tile and one that counts as left behind.

Front and rear wheels are 3.2 units apart and a tile is 3.5 units long, so a tile three steps
behind the foremost one is out of reach of every wheel, whichever way the car points.
"""


class TileProgress:
    """
    Follows the car along the lap by the tiles that its wheels begin to touch.

    The position is counted in tiles from the start and not wrapped at the start line. It moves
    to each touched tile by the shorter way round the lap: driving on counts it up, reversing
    counts it down, a spin moves it to and fro, and a shortcut over the grass takes it past
    everything between. `head` is the foremost position so far. A tile is *missed* when no wheel
    has touched it and the head is at least `PASSED_BEHIND` tiles beyond it; it stops being missed
    as soon as a wheel touches it after all. Tiles that are reached backwards from the start are
    not beyond the head, so nothing is missed by reversing.

    Within one frame wheels touch tiles in whatever order the physics finds them, so the position
    may end on any of those. `place` is what it means to be: the foremost tile under a wheel,
    counted in the same way; `locate` brings it up to date where it is `stale`.
    """

    __slots__ = (
        '_checked', '_missed', '_position', '_total', '_visited', 'head', 'place', 'stale')

    def __init__(self, total: int) -> None:
        """Start at tile 0 of a lap of `total` tiles with nothing visited."""
        self._total = total
        self._visited = bytearray(total)
        self._position = 0
        self._checked = 0
        self._missed: set[int] = set()
        self.head = 0
        self.place = 0
        self.stale = False

    @property
    def missed(self) -> int:
        """Tiles left behind unvisited at this moment."""
        return len(self._missed)

    @property
    def came_round(self) -> bool:
        """Return whether the head has passed the start line and every tile before it."""
        return self.head >= self._total + PASSED_BEHIND - 1

    @property
    def missed_tiles(self) -> frozenset[int]:
        """The indices of the tiles that are missed at this moment."""
        return frozenset(self._missed)

    def touch(self, index: int) -> None:
        """Move to tile `index`, which a wheel has begun to touch, and count it as visited."""
        total = self._total
        self.stale = True
        if not self._visited[index]:
            self._visited[index] = 1
            self._missed.discard(index)
        ahead = (index - self._position) % total
        if ahead == 0:
            return
        if ahead > total // 2:
            ahead -= total
        self._position += ahead
        if self._position > self.head:
            self.head = self._position
            end = min(self.head - PASSED_BEHIND + 1, total)
            for tile in range(self._checked, end):
                if not self._visited[tile]:
                    self._missed.add(tile)
            self._checked = max(self._checked, end)

    def locate(self, under_wheels: Iterable[int]) -> None:
        """Take the place of a car whose wheels stand on some tiles; without any it stays."""
        self.stale = False
        here, total, half = self.place, self._total, self._total // 2
        self.place += max(
            ((index - here + half) % total - half for index in under_wheels), default=0)
