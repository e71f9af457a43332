# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Where the road of a track lies, equal to gymnasium's `CarRacing._create_track` to the last bit.

Gymnasium steers a point through twelve random checkpoints, several times round, and takes one
whole round of its path as the middle of the road. The same is done here by compiled loops from the
same random numbers; nothing is created in Box2D.
"""

from math import atan2
from math import cos
from math import pi
from math import sin
from math import sqrt
from typing import NamedTuple

from gymnasium.envs.box2d.car_racing import BORDER
from gymnasium.envs.box2d.car_racing import BORDER_MIN_COUNT
from gymnasium.envs.box2d.car_racing import SCALE
from gymnasium.envs.box2d.car_racing import TRACK_DETAIL_STEP
from gymnasium.envs.box2d.car_racing import TRACK_RAD
from gymnasium.envs.box2d.car_racing import TRACK_TURN_RATE
from gymnasium.envs.box2d.car_racing import TRACK_WIDTH
import numpy as np

from msgs_bridge.compiled import compiled

CHECKPOINTS = 12
START_ALPHA = 2 * pi * (-0.5) / CHECKPOINTS
"""Angle of the start line around the middle of the playfield, radians."""

_LONGEST_PATH = 2500
_LAPS = 4

# The columns of a path.
_ALPHA = 0
_BETA = 1
_X = 2
_Y = 3


class TrackLayout(NamedTuple):
    """One closed round of road."""

    middle: np.ndarray
    """float64 (n, 4): angle around the playfield, heading, x and y of each tile's front edge."""

    tiles: np.ndarray
    """float64 (n, 4, 2): corners of the tiles."""

    bordered: np.ndarray
    """bool (n,): whether a red or white border lies beside each tile."""

    borders: np.ndarray
    """float64 (n, 4, 2): corners of the borders, where there are any."""


def lay_track(rng: np.random.Generator) -> TrackLayout | None:
    """
    Try to lay a track with the next 24 random numbers of `rng`.

    Returns:
        The track, or None if its ends do not meet, in which case gymnasium tries again.
    """
    checkpoints = np.empty((CHECKPOINTS, 3))
    for c in range(CHECKPOINTS):
        noise = rng.uniform(0, 2 * pi * 1 / CHECKPOINTS)
        alpha = 2 * pi * c / CHECKPOINTS + noise
        radius = rng.uniform(TRACK_RAD / 3, TRACK_RAD)
        if c == 0:
            alpha = 0
            radius = 1.5 * TRACK_RAD
        if c == CHECKPOINTS - 1:
            alpha = 2 * pi * c / CHECKPOINTS
            radius = 1.5 * TRACK_RAD
        checkpoints[c] = alpha, radius * cos(alpha), radius * sin(alpha)
    path = np.empty((_LONGEST_PATH, 4))
    first, end = closed_round(path, follow_checkpoints(checkpoints, path))
    if end < 0:
        return None
    middle = path[first:end].copy()
    count = len(middle)
    tiles = np.empty((count, 4, 2))
    bordered = np.zeros(count, np.bool_)
    borders = np.zeros((count, 4, 2))
    pave(middle, tiles, bordered, borders)
    return TrackLayout(middle, tiles, bordered, borders)


@compiled
def follow_checkpoints(checkpoints, path):
    """
    Steer a point through the checkpoints, round after round.

    Args:
        checkpoints: float64 (CHECKPOINTS, 3): angle around the playfield, x and y.
        path: float64 (n, 4), written: angle, heading, x and y of each step.

    Returns:
        How many steps there are.
    """
    count = checkpoints.shape[0]
    x, y, beta = 1.5 * TRACK_RAD, 0.0, 0.0
    target = 0
    laps = 0
    steps = 0
    visited_other_side = False
    while True:
        alpha = atan2(y, x)
        if visited_other_side and alpha > 0:
            laps += 1
            visited_other_side = False
        if alpha < 0:
            visited_other_side = True
            alpha += 2 * pi

        found = False
        while not found:
            while True:
                if alpha <= checkpoints[target % count, 0]:
                    found = True
                    break
                target += 1
                if target % count == 0:
                    break
            if not found:
                alpha -= 2 * pi

        along_x = cos(beta)
        along_y = sin(beta)
        to_x = checkpoints[target % count, 1] - x
        to_y = checkpoints[target % count, 2] - y
        ahead = along_x * to_x + along_y * to_y
        while beta - alpha > 1.5 * pi:
            beta -= 2 * pi
        while beta - alpha < -1.5 * pi:
            beta += 2 * pi
        before = beta
        ahead *= SCALE
        if ahead > 0.3:
            beta -= min(TRACK_TURN_RATE, abs(0.001 * ahead))
        if ahead < -0.3:
            beta += min(TRACK_TURN_RATE, abs(0.001 * ahead))
        x += -along_y * TRACK_DETAIL_STEP
        y += along_x * TRACK_DETAIL_STEP
        path[steps, _ALPHA] = alpha
        path[steps, _BETA] = before * 0.5 + beta * 0.5
        path[steps, _X] = x
        path[steps, _Y] = y
        steps += 1
        if laps > _LAPS or steps == path.shape[0]:
            return steps


@compiled
def closed_round(path, steps):
    """
    Find the last whole round of a path.

    Args:
        path: float64 (n, 4): see `follow_checkpoints`.
        steps: How many steps of it there are.

    Returns:
        The first step of the round and the one after its last, or (-1, -1) without one whose
        ends meet.
    """
    first = -1
    last = -1
    for i in range(steps - 1, 0, -1):
        if path[i, _ALPHA] > START_ALPHA and path[i - 1, _ALPHA] <= START_ALPHA:
            if last == -1:
                last = i
            else:
                first = i
                break
    if first == -1:
        return -1, -1
    end = last - 1
    beta = path[first, _BETA]
    gap_x = cos(beta) * (path[first, _X] - path[end - 1, _X])
    gap_y = sin(beta) * (path[first, _Y] - path[end - 1, _Y])
    if sqrt(gap_x * gap_x + gap_y * gap_y) > TRACK_DETAIL_STEP:
        return -1, -1
    return first, end


@compiled
def pave(middle, tiles, bordered, borders):
    """
    Lay tiles along the middle of the road, and borders in hard bends.

    Args:
        middle: float64 (n, 4): see `TrackLayout`.
        tiles: float64 (n, 4, 2), written.
        bordered: bool (n,), all False; written.
        borders: float64 (n, 4, 2), written where there is a border.
    """
    count = middle.shape[0]
    for i in range(count):
        hard = True
        one_side = 0
        for back in range(BORDER_MIN_COUNT):
            turn = middle[i - back, _BETA] - middle[i - back - 1, _BETA]
            hard &= abs(turn) > TRACK_TURN_RATE * 0.2
            one_side += 1 if turn > 0 else (-1 if turn < 0 else 0)
        bordered[i] = hard and abs(one_side) == BORDER_MIN_COUNT
    for i in range(count):
        if bordered[i]:
            for back in range(BORDER_MIN_COUNT):
                bordered[i - back] = True

    for i in range(count):
        beta_1, x_1, y_1 = middle[i, _BETA], middle[i, _X], middle[i, _Y]
        beta_2, x_2, y_2 = middle[i - 1, _BETA], middle[i - 1, _X], middle[i - 1, _Y]
        cos_1, sin_1 = cos(beta_1), sin(beta_1)
        cos_2, sin_2 = cos(beta_2), sin(beta_2)
        tiles[i, 0, 0] = x_1 - TRACK_WIDTH * cos_1
        tiles[i, 0, 1] = y_1 - TRACK_WIDTH * sin_1
        tiles[i, 1, 0] = x_1 + TRACK_WIDTH * cos_1
        tiles[i, 1, 1] = y_1 + TRACK_WIDTH * sin_1
        tiles[i, 2, 0] = x_2 + TRACK_WIDTH * cos_2
        tiles[i, 2, 1] = y_2 + TRACK_WIDTH * sin_2
        tiles[i, 3, 0] = x_2 - TRACK_WIDTH * cos_2
        tiles[i, 3, 1] = y_2 - TRACK_WIDTH * sin_2
        if bordered[i]:
            turn = beta_2 - beta_1
            side = 1.0 if turn > 0 else (-1.0 if turn < 0 else 0.0)
            near = side * TRACK_WIDTH
            far = side * (TRACK_WIDTH + BORDER)
            borders[i, 0, 0] = x_1 + near * cos_1
            borders[i, 0, 1] = y_1 + near * sin_1
            borders[i, 1, 0] = x_1 + far * cos_1
            borders[i, 1, 1] = y_1 + far * sin_1
            borders[i, 2, 0] = x_2 + far * cos_2
            borders[i, 2, 1] = y_2 + far * sin_2
            borders[i, 3, 0] = x_2 + near * cos_2
            borders[i, 3, 1] = y_2 + near * sin_2
