# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Makes sure that the fast simulator equals gymnasium where that has not been proven."""

from functools import cache
import platform
from typing import NamedTuple

import Box2D
import gymnasium
from gymnasium.envs.box2d.car_racing import CarRacing
import numpy as np
import pygame

from carracing_sim_node.fast_renderer import FastRenderer
from carracing_sim_node.simulation import Simulation


class Surroundings(NamedTuple):
    """Everything outside this package that decides a frame."""

    gymnasium: str
    pygame: str
    box2d: str
    system: str
    machine: str
    smoothscale: str


PROVEN = frozenset({Surroundings('1.4.0', '2.5.8', '2.3.10', 'Linux', 'x86_64', 'SSE2')})
"""
Where `carracing bench sim --frames 100000` found every frame equal.

With these nothing is compared at start; with any others a few frames are.
"""

COMPARED_TRACKS = 20
"""Seeds whose tracks are compared corner by corner."""

COMPARED_SEEDS = (0, 7)
COMPARED_FRAMES = 60
"""Frames compared per seed: the whole zoom and some after it, accelerating through a bend."""


def surroundings() -> Surroundings:
    """Return what is installed here."""
    return Surroundings(
        gymnasium.__version__,
        pygame.version.ver,
        Box2D.__version__,
        platform.system(),
        platform.machine().lower().replace('amd64', 'x86_64'),
        pygame.transform.get_smoothscale_backend(),
    )


@cache
def difference() -> str:
    """
    Return how the fast simulator differs from gymnasium here, or an empty string.

    The answer is found once per process. Where nothing is proven it costs about a second.
    """
    here = surroundings()
    if here in PROVEN:
        return ''
    where = compare_tracks(COMPARED_TRACKS) or compare(COMPARED_SEEDS, COMPARED_FRAMES)
    if not where:
        return ''
    return (
        f'the fast simulator differs from gymnasium {here.gymnasium} with pygame {here.pygame} '
        f'and Box2D {here.box2d} on {here.system} {here.machine} ({where})'
    )


def compare_tracks(count: int) -> str:
    """
    Lay tracks with gymnasium's code and with ours.

    Args:
        count: Seeds to compare, from 0 on.

    Returns:
        What differed first, or an empty string.
    """
    # Our simulation runs gymnasium's code, without its drawing, when told to.
    stock = Simulation(own_code=False)
    ours = Simulation()
    for seed in range(count):
        stock.reset(seed=seed)
        ours.reset(seed=seed)
        same = len(stock.road_poly) == len(ours.road_poly) and all(
            np.array_equal(expected[0], got[0]) and tuple(expected[1]) == tuple(got[1])
            for expected, got in zip(stock.road_poly, ours.road_poly)
        )
        if not same or stock.track != ours.track:
            return f'the track of seed {seed}'
    return ''


def compare(seeds: tuple[int, ...], frames: int) -> str:
    """
    Drive the same way in gymnasium's environment and in ours.

    Args:
        seeds: Tracks to drive on.
        frames: Frames per track.

    Returns:
        What differed first, or an empty string.
    """
    stock = CarRacing()
    sim = Simulation()
    renderer = FastRenderer(sim, settled_zoom=False)
    for seed in seeds:
        expected, _ = stock.reset(seed=seed)
        sim.reset(seed=seed)
        if not np.array_equal(expected, renderer.draw()):
            return f'the first frame of seed {seed}'
        for frame in range(frames):
            action = (0.2 * (frame // 15 % 3 - 1), 0.7, 0.3 * (frame % 40 > 36))
            expected, reward, terminated, _, _ = stock.step(np.array(action))
            ours, lap_finished, off_field = sim.advance(*action)
            if reward != ours or terminated != (lap_finished or off_field):
                return f'the reward or the end in frame {frame} of seed {seed}'
            if not np.array_equal(expected, renderer.draw()):
                return f'frame {frame} of seed {seed}'
    return ''
