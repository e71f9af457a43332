# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The model's laps that a person races against, frame by frame, and the file they travel in."""
from __future__ import annotations

import bisect
from collections.abc import Iterable
import dataclasses
import itertools
import json
import math
from pathlib import Path

from msgs_bridge.atomic_write import write_text
from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular

MAX_BYTES = 32 * 2**20


@dataclasses.dataclass(frozen=True)
class Rival:
    """
    One lap of a model.

    Attributes:
        seed: of the track.
        returns: sum of the rewards after so many simulated frames; the first is 0.
        tiles: tiles visited after so many frames, never falling.
        finished: whether all tiles were visited.
    """

    seed: int
    returns: list[float]
    tiles: list[int]
    finished: bool

    def at(self, frames: int) -> tuple[float, int]:
        """Return its return and tiles after so many frames; the last ones once it has ended."""
        place = max(0, min(frames, len(self.returns) - 1))
        return self.returns[place], self.tiles[place]

    def frames_for(self, tiles: int) -> int | None:
        """Return after how many frames it had visited so many tiles; None: it never had."""
        place = bisect.bisect_left(self.tiles, tiles)
        return place if place < len(self.tiles) else None


def write_rivals(path: Path, name: str, rivals: Iterable[Rival]) -> None:
    """Write laps of a model whole or not at all; raises OSError."""
    write_text(path, json.dumps(
        {'name': name, 'laps': [dataclasses.asdict(rival) for rival in rivals]}))


def read_rivals(path: Path | str) -> tuple[str, dict[int, Rival]]:
    """
    Return the name of the model and its laps by seed.

    Raises:
        SettingsError: the file is not there or is something else.
    """
    data = read_regular(path, MAX_BYTES, SettingsError)
    try:
        found = json.loads(data)
        rivals = [
            Rival(int(lap['seed']), list(map(float, lap['returns'])),
                  list(map(int, lap['tiles'])), bool(lap['finished'])) for lap in found['laps']]
        if not all(rival.returns and len(rival.returns) == len(rival.tiles) for rival in rivals):
            raise ValueError('returns and tiles of another length')
        if not all(map(_goes_on, rivals)):
            raise ValueError('returns that are no numbers, or tiles that fall')
        return plain(found['name']), {rival.seed: rival for rival in rivals}
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise SettingsError(
            f'{path} holds no laps to race against: {type(error).__name__} {plain(error)}'
        ) from None


def _goes_on(rival: Rival) -> bool:
    """Return whether a lap is one that can have been driven."""
    return all(map(math.isfinite, rival.returns)) and all(
        before <= after for before, after in itertools.pairwise(rival.tiles))
