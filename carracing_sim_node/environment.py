# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The environment: gymnasium's CarRacing-v3, with action repeat and variants as parameters."""

from collections.abc import Sequence
from typing import Any

import gymnasium
from gymnasium.envs.box2d.car_racing import FPS
import numpy as np

from carracing_sim_node.errors import EpisodeError
from carracing_sim_node.errors import InvalidActionError
from carracing_sim_node.errors import InvalidVariantError
from carracing_sim_node.facts import Facts
from carracing_sim_node.renderer import RENDERERS
from carracing_sim_node.renderer import build
from carracing_sim_node.simulation import Simulation

MAX_EPISODE_STEPS = 1000
"""Frames after which gymnasium's registered CarRacing-v3 truncates an episode."""

_DISCRETE_CONTROLS = (
    (0.0, 0.0, 0.0),
    (0.6, 0.0, 0.0),
    (-0.6, 0.0, 0.0),
    (0.0, 0.2, 0.0),
    (0.0, 0.0, 0.8),
)


class CarRacingEnvironment(gymnasium.Env):
    """
    CarRacing-v3, drawn several times faster and equal to the byte.

    ## Description
    Track, physics, reward and ends are gymnasium's own; the frame is drawn by
    `carracing_sim_node.renderer`. Without variants and with an action repeat of 1, everything
    that `reset` and `step` return equals what `gymnasium.make('CarRacing-v3')` returns.

    ## Action space
    As gymnasium's: a float array (steer in [-1, 1], gas in [0, 1], brake in [0, 1]), or with
    `continuous=False` one of 0 nothing, 1 right, 2 left, 3 gas, 4 brake.

    ## Observation space
    uint8 (96, 96, 3), rows from the top, RGB.

    ## Rewards
    -0.1 per frame and 1000/N for each of the N tiles when a wheel first touches it. The tiles
    under the car at the start are paid with the first `step`. The frame that leaves the playfield
    gives -100 and nothing else. With an action repeat the rewards of the frames are added up.

    ## Starting state
    At rest in the middle of the road. The first second (50 frames) zooms in from the whole track.

    ## Episode end
    Terminated when every tile is visited (`info['lap_finished']` is True; gymnasium's
    `lap_complete_percent` has no effect in v3, gymnasium issue 1269), or when the car leaves
    the playfield of 333.3 units (`info['lap_finished']` is False). Truncated after
    `max_episode_steps` frames, and by the variants `early_end_frames` and `early_end_lap`.
    """

    metadata = {'render_modes': ['rgb_array'], 'render_fps': FPS}

    def __init__(
        self,
        *,
        action_repeat: int = 1,
        zoom: bool = True,
        early_end_frames: int = 0,
        early_end_lap: bool = False,
        domain_randomize: bool = False,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        renderer: str = 'auto',
        continuous: bool = True,
    ) -> None:
        """
        Create the environment.

        Args:
            action_repeat: Frames for which one `step` holds its action; only the last is drawn.
            zoom: False draws the first second with the zoom that follows it (a variant).
            early_end_frames: Truncate an episode after this many frames without a new tile
                (a variant); 0 never does.
            early_end_lap: Truncate an episode when the car has come round to the start and left
                tiles behind unvisited (a variant).
            domain_randomize: Gymnasium's own variant: other colours with every reset.
            max_episode_steps: Truncate after this many frames; None never does.
            renderer: `fast` (raises if it cannot run), `stock` (gymnasium's own code throughout),
                or `auto`: fast where it can run and equals gymnasium, otherwise stock with a
                warning.
            continuous: False takes gymnasium's five discrete actions.

        Raises:
            InvalidVariantError: If a parameter has a value that it does not take.
            RendererUnavailableError: If the renderer `fast` is asked for and cannot run.
        """
        _check_count('action_repeat', action_repeat, least=1)
        _check_count('early_end_frames', early_end_frames, least=0)
        if max_episode_steps is not None:
            _check_count('max_episode_steps', max_episode_steps, least=1)
        for name, value in (
            ('zoom', zoom),
            ('early_end_lap', early_end_lap),
            ('domain_randomize', domain_randomize),
            ('continuous', continuous),
        ):
            if not isinstance(value, (bool, np.bool_)):
                raise InvalidVariantError(f'{name} is {value!r}; expected True or False')
        if renderer not in RENDERERS:
            accepted = ', '.join(RENDERERS)
            raise InvalidVariantError(f'renderer is {renderer!r}; expected one of {accepted}')

        self.action_repeat = int(action_repeat)
        self.zoom = bool(zoom)
        self.early_end_frames = int(early_end_frames)
        self.early_end_lap = bool(early_end_lap)
        self.max_episode_steps = max_episode_steps
        self.continuous = bool(continuous)
        self._sim, self._renderer = build(
            renderer, domain_randomize=bool(domain_randomize), settled_zoom=not self.zoom
        )
        self.action_space = self._sim.action_space
        if not self.continuous:
            self.action_space = gymnasium.spaces.Discrete(len(_DISCRETE_CONTROLS))
        self.observation_space = self._sim.observation_space
        self.render_mode = 'rgb_array'
        self._running = False
        self._ended = False
        self._ended_early = False
        self._lap_finished = False
        self._last_new_tile = 0

    @property
    def renderer_name(self) -> str:
        """The renderer in use: `fast`, or `stock` for gymnasium's own code throughout."""
        return self._renderer.name

    @property
    def simulation(self) -> Simulation:
        """The physics behind this environment, for those who have to look inside."""
        return self._sim

    @property
    def np_random(self) -> np.random.Generator:
        """The generator of the tracks."""
        return self._sim.np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._sim.np_random = value

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """
        Start an episode on a new track.

        Args:
            seed: Seed of the track; None goes on with the present generator.
            options: Gymnasium's; `{'randomize': False}` keeps the colours with
                `domain_randomize`.

        Returns:
            The first frame, uint8 (96, 96, 3), and an empty dict.
        """
        self._running = False
        self._sim.reset(seed=seed, options=options)
        # Where gymnasium's wrappers and its checker look for them.
        self._np_random = self._sim.np_random
        self._np_random_seed = self._sim.np_random_seed
        self._running = True
        self._ended = False
        self._ended_early = False
        self._lap_finished = False
        self._last_new_tile = 0
        return self._renderer.draw(), {}

    def step(
        self, action: Any, *, draw: bool = True
    ) -> tuple[np.ndarray | None, float, bool, bool, dict]:
        """
        Hold `action` for up to `action_repeat` frames and draw the last of them.

        Args:
            action: One element of the action space.
            draw: False draws nothing and returns None in place of the frame.

        Returns:
            The frame, uint8 (96, 96, 3); the sum of the frames' rewards; whether the episode
            has terminated; whether it was truncated; and gymnasium's info. With an action
            repeat above 1 `info['frames']` is how many frames were simulated: the group stops
            at the frame that ends the episode. `info['ended_early']` is there, and True, when
            a variant, `early_end_frames` or `early_end_lap`, ended it.

        Raises:
            InvalidActionError: If the action is not an element of the action space.
            EpisodeError: If there was no `reset`, or the episode is over.
        """
        self._check_running()
        frames, reward, terminated, truncated, info = self._hold(
            self._controls(action), self.action_repeat)
        if self.action_repeat > 1:
            info['frames'] = frames
        return self._renderer.draw() if draw else None, reward, terminated, truncated, info

    def advance(
        self, controls: tuple[float, float, float], frames: int, *, draw: bool = True
    ) -> tuple[np.ndarray | None, float, bool, bool, int]:
        """
        Do what `step` does for any number of frames, with controls that are known to be good.

        Args:
            controls: Steer in [-1, 1], gas and brake in [0, 1].
            frames: For how many frames to hold them, at most.
            draw: As in `step`.

        Returns:
            The frame, the sum of the rewards, whether the episode has terminated, whether it was
            truncated, and how many frames were simulated.

        Raises:
            EpisodeError: If there was no `reset`, or the episode is over.
        """
        self._check_running()
        frames, reward, terminated, truncated, _ = self._hold(controls, frames)
        return self._renderer.draw() if draw else None, reward, terminated, truncated, frames

    def _check_running(self) -> None:
        if not self._running:
            raise EpisodeError('no episode is running; call reset() first')
        if self._ended:
            raise EpisodeError('the episode is over; call reset() to start the next one')

    def _hold(
        self, controls: tuple[float, float, float], limit: int
    ) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """Simulate up to `limit` frames; return how many, reward, ends and gymnasium's info."""
        steer, gas, brake = controls
        sim = self._sim
        reward = 0.0
        frames = 0
        terminated = truncated = False
        info: dict[str, Any] = {}
        while frames < limit:
            tiles = sim.tile_visited_count
            frame_reward, lap_finished, off_field = sim.advance(steer, gas, brake)
            frames += 1
            reward = reward + frame_reward if frames > 1 else frame_reward
            if sim.tile_visited_count != tiles:
                self._last_new_tile = sim.frames
            if lap_finished or off_field:
                terminated = True
                self._lap_finished = lap_finished and not off_field
                info['lap_finished'] = self._lap_finished
            if sim.frames == self.max_episode_steps:
                truncated = True
            waited = sim.frames - self._last_new_tile
            if not terminated and (
                    0 < self.early_end_frames <= waited
                    or self.early_end_lap and sim.contacts.progress.came_round):
                truncated = self._ended_early = True
                info['ended_early'] = True
            if terminated or truncated:
                self._ended = True
                break
        return frames, reward, terminated, truncated, info

    def facts(self) -> Facts:
        """
        Return what the physics knows of the episode after the last frame.

        Raises:
            EpisodeError: If there was no `reset`.
        """
        if not self._running:
            raise EpisodeError('no episode is running; call reset() first')
        sim = self._sim
        return Facts(
            frames=sim.frames,
            tiles_visited=sim.tile_visited_count,
            tiles_total=len(sim.track),
            tiles_missed=sim.contacts.progress.missed,
            lap_position=sim.contacts.progress.place,
            wheels_off_road=0.25 * sum(not wheel.tiles for wheel in sim.car.wheels),
            speed=sim.speed,
            standing_still=sim.standing_still,
            came_round=sim.contacts.progress.came_round,
            lap_finished=self._lap_finished,
            ended_early=self._ended_early,
        )

    def render(self) -> np.ndarray:
        """
        Draw the present frame large, with skid marks, by gymnasium's own code (slow).

        Returns:
            uint8 (400, 600, 3).

        Raises:
            EpisodeError: If there was no `reset`.
        """
        if not self._running:
            raise EpisodeError('no episode is running; call reset() first')
        return self._sim.draw_stock('rgb_array', settled_zoom=not self.zoom)

    def draw(self) -> np.ndarray:
        """
        Draw the present frame, uint8 (96, 96, 3), as `step` would have.

        Raises:
            EpisodeError: If there was no `reset`.
        """
        if not self._running:
            raise EpisodeError('no episode is running; call reset() first')
        return self._renderer.draw()

    def skip_episodes(self, count: int, *, seed: int | None = None) -> None:
        """
        Go on to the track that comes after `count` more resets, without cars or drawing.

        The episode that was running is over afterwards; the next `reset()` without a seed gives
        the track it would have given after `count` resets (each with its default options).

        Args:
            count: Resets to pass over.
            seed: If given, the first of the resets that are passed over is `reset(seed=seed)`.

        Raises:
            InvalidVariantError: If `count` is not a whole number of at least 0.
        """
        _check_count('count', count, least=0)
        self._running = False
        if seed is not None and count:
            self._sim.np_random = gymnasium.utils.seeding.np_random(seed)[0]
        for _ in range(count):
            self._sim.skip_reset()

    def close(self) -> None:
        """Let go of the episode."""
        self._running = False
        self._sim.close()

    def _controls(self, action: Any) -> tuple[float, float, float]:
        """Return (steer, gas, brake) of an action, or raise InvalidActionError."""
        if not self.continuous:
            if not self.action_space.contains(action):
                raise InvalidActionError(
                    f'action is {action!r}; expected a whole number from 0 to 4'
                )
            return _DISCRETE_CONTROLS[int(action)]
        values = action.tolist() if isinstance(action, np.ndarray) else action
        if not isinstance(values, Sequence) or isinstance(values, (str, bytes)):
            raise InvalidActionError(f'action is {action!r}; expected {_BOX}')
        if len(values) != 3:
            raise InvalidActionError(f'action has {len(values)} elements; expected {_BOX}')
        try:
            steer, gas, brake = (float(value) for value in values)
        except (TypeError, ValueError):
            raise InvalidActionError(f'action is {action!r}; expected {_BOX}') from None
        # Written so that NaN fails: every comparison with it is False.
        if -1.0 <= steer <= 1.0 and 0.0 <= gas <= 1.0 and 0.0 <= brake <= 1.0:
            return steer, gas, brake
        raise InvalidActionError(
            f'action is steer {steer}, gas {gas}, brake {brake}; expected {_BOX}'
        )


_BOX = 'three numbers: steer in [-1, 1], gas in [0, 1], brake in [0, 1]'


def _check_count(name: str, value: Any, *, least: int) -> None:
    """Raise InvalidVariantError unless `value` is a whole number of at least `least`."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < least:
        raise InvalidVariantError(
            f'{name} is {value!r}; expected a whole number of at least {least}'
        )


make_env = CarRacingEnvironment
"""What users of the environment call, beside `gymnasium.make`."""
