# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the physics knows about an episode, beside pixels and reward."""

from typing import NamedTuple


class Facts(NamedTuple):
    """
    The state of an episode after the last frame, read from the physics.

    None of this enters the observation or the reward: it is there for shaping, for early ends
    and for the record.
    """

    frames: int
    """Frames simulated since `reset`; the frame that `reset` itself simulates is not counted."""

    tiles_visited: int
    """Road tiles that any wheel has touched in this episode."""

    tiles_total: int
    """Road tiles of this track."""

    tiles_missed: int
    """Tiles that the car has left behind unvisited; see `progress.TileProgress`."""

    lap_position: int
    """Foremost tile under a wheel, counted on from the start; see `progress.TileProgress`."""

    wheels_off_road: float
    """Share of the four wheels that touch no road tile: 0, 0.25, 0.5, 0.75 or 1."""

    speed: float
    """Speed of the hull in simulator units per second (the road is 13.3 units wide)."""

    standing_still: int
    """Consecutive frames, up to this one, with a speed below `simulation.STANDING_SPEED`."""

    came_round: bool
    """The car has come round to the start and left the last tile behind, whatever it missed."""

    lap_finished: bool
    """The episode has ended with every tile visited."""

    ended_early: bool
    """A variant, `early_end_frames` or `early_end_lap`, has ended this episode."""
