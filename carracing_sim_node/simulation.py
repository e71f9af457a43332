# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Gymnasium's CarRacing-v3 with its drawing taken off, so that frames can pass undrawn."""

from collections.abc import Callable
from math import sqrt
from types import SimpleNamespace
from typing import Any

from gymnasium.envs.box2d.car_racing import FPS
from gymnasium.envs.box2d.car_racing import PLAYFIELD
from gymnasium.envs.box2d.car_racing import CarRacing
import numpy as np

from carracing_sim_node.car_step import press_pedals
from carracing_sim_node.car_step import push_wheels
from carracing_sim_node.contacts import TileContacts
from carracing_sim_node.contacts import WatchedContacts
from carracing_sim_node.errors import InvalidActionError

STANDING_SPEED = 1.0
"""Below this speed of the hull, in units per second, the car stands (full speed is about 100)."""

OFF_FIELD_REWARD = -100
"""What gymnasium gives, in place of anything else, for the frame in which the car leaves."""

_DT = 1.0 / FPS
_VELOCITY_ITERATIONS = 6 * 30
_POSITION_ITERATIONS = 2 * 30


class Simulation(CarRacing):
    """
    Tracks, physics, reward and ends of gymnasium's environment, one frame at a time.

    `advance` is gymnasium's `step` without its drawing, with the controls as three numbers.
    Box2D moves what gymnasium's constructors have created; what gymnasium does in Python around
    that is done by this package's code, which is equal and faster, or by gymnasium's.
    """

    def __init__(self, *, domain_randomize: bool = False, own_code: bool = True) -> None:
        """
        Create an empty world.

        Args:
            domain_randomize: Gymnasium's argument: other colours with every reset.
            own_code: Lay tracks, and apply wheel forces, contacts and rewards, with this
                package's code (which needs Numba) instead of gymnasium's.
        """
        super().__init__(domain_randomize=domain_randomize, continuous=True)
        self._own_code = own_code
        self._lay_track: Callable[[np.random.Generator], Any] | None = None
        if own_code:
            # Imported here because they need Numba, which an installation may lack.
            from carracing_sim_node.tiles import create_tiles
            from carracing_sim_node.track_layout import lay_track

            self._lay_track = lay_track
            self._create_tiles = create_tiles
        self.on_new_track: Callable[[], None] | None = None
        self.on_tile_faded: Callable[[int], None] | None = None
        self.contacts: TileContacts | None = None
        self.frames = 0
        self.standing_still = 0
        self.speed = 0.0
        self.shown_reward = 0.0

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[None, dict]:
        """Start an episode as gymnasium does, drawing nothing."""
        self.frames = 0
        self.standing_still = 0
        super().reset(seed=seed, options=options)
        return None, {}

    def step(self, action: None) -> tuple[None, float, bool, bool, dict]:
        """
        Simulate the one frame without controls that gymnasium's `reset` asks for.

        Raises:
            InvalidActionError: somebody means to drive, which `advance` does.
        """
        if action is not None:
            raise InvalidActionError(
                f'action is {action!r}; a Simulation is driven by advance(steer, gas, brake)')
        if self._own_code:
            self._simulate()
        else:
            super().step(action)
            self._measure()
        return None, 0.0, False, False, {}

    def advance(self, steer: float, gas: float, brake: float) -> tuple[float, bool, bool]:
        """
        Simulate one frame of 1/50 s.

        Args:
            steer: Wanted steering, negative to the left, in [-1, 1].
            gas: Wanted gas in [0, 1].
            brake: Brake in [0, 1].

        Returns:
            The reward of the frame, whether the lap was finished in it, and whether the car has
            left the playfield in it. Either of the two ends the episode.
        """
        self.frames += 1
        if not self._own_code:
            return self._advance_by_gymnasium(steer, gas, brake)
        press_pedals(self.car, -steer, gas, brake)
        self._simulate()
        self._count_standing()

        self.reward -= 0.1
        self.car.fuel_spent = 0.0
        reward = self.reward - self.prev_reward
        self.prev_reward = self.reward
        lap_finished = self.tile_visited_count == len(self.track) or self.new_lap
        position = self.car.hull.position
        off_field = abs(position.x) > PLAYFIELD or abs(position.y) > PLAYFIELD
        if off_field:
            reward = OFF_FIELD_REWARD
        return reward, lap_finished, off_field

    def skip_reset(self) -> None:
        """Use the random numbers of one `reset` up; the next episode has to begin with another."""
        if self.domain_randomize:
            self._reinit_colors(True)
        if self._own_code:
            while self._lay_track(self.np_random) is None:
                pass
            return
        # gymnasium's method writes the track into whatever it is given
        stand_in = SimpleNamespace(
            np_random=self.np_random, road_color=self.road_color, fd_tile=self.fd_tile,
            world=_NoWorld(), road_poly=[], verbose=False)
        while not CarRacing._create_track(stand_in):
            pass

    def tile_faded(self, index: int) -> None:
        """Pass on that tile `index` has taken the plain road colour."""
        if self.on_tile_faded is not None:
            self.on_tile_faded(index)

    def draw_stock(self, mode: str = 'state_pixels', *, settled_zoom: bool = False) -> np.ndarray:
        """
        Draw the present frame with gymnasium's own code.

        Args:
            mode: `state_pixels` for uint8 (96, 96, 3) or `rgb_array` for uint8 (400, 600, 3).
            settled_zoom: Draw the first second with the zoom that follows it.
        """
        time, reward = self.t, self.reward
        if settled_zoom:
            self.t = max(time, 1.0)
        if mode == 'state_pixels':
            self.reward = self.shown_reward
        try:
            return CarRacing._render(self, mode)
        finally:
            self.t, self.reward = time, reward

    def _simulate(self) -> None:
        """Let one frame of physics pass."""
        push_wheels(self.car, _DT)
        self.world.Step(_DT, _VELOCITY_ITERATIONS, _POSITION_ITERATIONS)
        self.t += _DT
        self._measure()
        # Gymnasium draws before it charges the frame, so the score in the frame lacks that 0.1.
        self.shown_reward = self.reward

    def _measure(self) -> None:
        """Take the speed of the hull, units per second, and the place on the lap."""
        velocity = self.car.hull.linearVelocity
        x = velocity.x
        y = velocity.y
        self.speed = sqrt(x * x + y * y)
        progress = self.contacts.progress
        if progress.stale:
            progress.locate(tile.idx for wheel in self.car.wheels for tile in wheel.tiles)

    def _count_standing(self) -> None:
        """Count the frames for which the car has stood."""
        self.standing_still = self.standing_still + 1 if self.speed < STANDING_SPEED else 0

    def _advance_by_gymnasium(
        self, steer: float, gas: float, brake: float
    ) -> tuple[float, bool, bool]:
        """Do what `advance` does with gymnasium's own `step`."""
        action = np.array([steer, gas, brake])
        _, reward, terminated, _, info = super().step(action)
        self._measure()
        self._count_standing()
        lap_finished = self.tile_visited_count == len(self.track) or self.new_lap
        return reward, lap_finished, terminated and not info['lap_finished']

    def _create_track(self) -> bool:
        """Create a track and watch it with our own contact listener; False asks to try again."""
        if self._own_code:
            layout = self._lay_track(self.np_random)
            if layout is None:
                return False
            self._create_tiles(self, layout)
        elif not super()._create_track():
            return False
        contacts = TileContacts if self._own_code else WatchedContacts
        self.contacts = contacts(self, self.lap_complete_percent)
        self.world.contactListener_bug_workaround = self.contacts
        self.world.contactListener = self.contacts
        if self.on_new_track is not None:
            self.on_new_track()
        return True

    def _render(self, mode: str) -> Any:
        """Draw nothing where gymnasium would, but keep the score that it would show."""
        self.shown_reward = self.reward
        return None


class _NoFixture:
    """Stands for the fixture of a tile that is not created."""

    sensor = False


class _NoBody:
    """Stands for the body of a tile that is not created."""

    fixtures = (_NoFixture(),)


class _NoWorld:
    """A world that creates nothing, for tracks of which only the random numbers matter."""

    def CreateStaticBody(self, **_: Any) -> _NoBody:  # noqa: N802 (gymnasium calls it so)
        """Return something that takes the attributes of a tile."""
        return _NoBody()
