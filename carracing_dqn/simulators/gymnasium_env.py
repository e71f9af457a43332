# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Any environment of Gymnasium as a `Simulator`: an id, and a mapping from commands to actions."""
from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import logging
import math
import re
from typing import Any, NamedTuple

from carracing_dqn.simulation.checks import let_go_of
from carracing_dqn.simulation.registry import look_here
from carracing_dqn.simulators.space_mapping import action_encoder
import gymnasium
from msgs_bridge.errors import SimulatorError
from msgs_bridge.images import MAX_SIDE
from msgs_bridge.picture_parts import cropped, parse_crop, resized
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import numbers, setting
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.twists import Command
from msgs_bridge.yaml_text import load_yaml
import numpy as np

OBSERVATION, RENDERED = 'observation', 'rendered'
RENDER_MODE = 'rgb_array'
# of an environment that names none in metadata['render_fps']
FRAMES_PER_SECOND = 30.0
SIZE = re.compile(r'\d{1,4}x\d{1,4}')


@dataclasses.dataclass(frozen=True)
class GymnasiumEnvSettings:
    """What can be set on an environment of Gymnasium."""

    environment: str = setting(
        '', 'id of the environment, such as Pendulum-v1, or module:id to import a module first')
    environment_options: str = setting(
        '{}', 'keyword arguments of gymnasium.make, as YAML')
    vectorized: bool = setting(
        False, 'true: make it by gymnasium.make_vec, one copy, for those that exist as such alone')
    max_episode_frames: int = setting(
        0, "frames after which an episode is truncated; 0 = the environment's own",
        low=0, high=10**9)
    frame_duration: float = setting(
        0.0, "simulated seconds of a frame; 0 = by the environment's render_fps",
        low=0.0, high=10.0)
    action: str = setting(
        '', 'how a command becomes an action, as YAML: carracing_dqn/simulators/space_mapping.py')
    picture: str = setting(
        RENDERED, 'the frame: rendered, observation, or observation.NAME of a Dict')
    picture_crop: str = setting(
        '', 'part of the picture in pixels, LEFT,TOP,WIDTH,HEIGHT; empty: all of it')
    picture_size: str = setting(
        '96x96', 'size of the frames, WIDTHxHEIGHT, averaged by area; empty: as it comes')
    info: str = setting(
        '{}', 'values that travel with step, as YAML: name -> info.PATH or observation.PATH, with '
        'a ? at its end if it may be missing, and is 0 then')
    frame_id: str = setting('camera', 'frame_id of the images')


class GymnasiumEnv(Simulator):
    """`gymnasium.make(environment)`, driven by commands and seen in pixels."""

    Settings = GymnasiumEnvSettings

    def __init__(self, settings: GymnasiumEnvSettings) -> None:
        """
        Make the environment.

        Raises:
            SimulatorError: there is no such environment, it has no picture of that kind, or the
                mapping does not fit its actions.
        """
        self.description = f'gymnasium.make({plain(settings.environment)!r})'
        self._settings = settings
        # by these a bag can be driven again
        self.constants = numbers(settings, self.Settings)
        self.env = _make(settings)
        with let_go_of(self.env):
            self._encode = action_encoder(
                self.env.action_space, load_yaml(settings.action, 'action', SimulatorError))
            self._picture = _picture_of(self.env, settings.picture)
            self._crop = parse_crop('picture_crop', settings.picture_crop, SimulatorError)
            self._size = _size_of(settings.picture_size)
            self._sources = _sources_of(settings.info)
            fps = (self.env.metadata or {}).get('render_fps') or FRAMES_PER_SECOND
            self.frame_seconds = settings.frame_duration or 1.0 / float(fps)

    def reset(self, seed: int | None) -> Outcome:
        """Begin an episode; with None the environment goes on with its own random numbers."""
        observation, info = self._guarded(lambda: self.env.reset(seed=seed))
        # what a reset does not say yet is 0
        values = self._values(observation, info)
        return Outcome(self._pixels(observation), info={
            name: 0.0 if value is None else value for name, value in values.items()})

    def advance(self, command: Command, frames: int = 1) -> Outcome:
        """Hold the action of a command for some steps of the environment."""
        reward, passed = 0.0, 0
        terminated = truncated = False
        while passed < frames and not (terminated or truncated):
            # a new one each time: an environment may write into its action
            observation, earned, terminated, truncated, info = self._guarded(
                lambda: self.env.step(self._encode(command)))
            reward += float(earned)
            passed += 1
        values = self._values(observation, info)
        for name, value in values.items():
            if value is None:
                if self._sources[name].needed:
                    raise SimulatorError(
                        f'info: {name}: {self._sources[name].text} is no number of this '
                        f'environment; info holds {plain(_names_in(info))}')
                values[name] = 0.0
        return Outcome(self._pixels(observation), reward, bool(terminated), bool(truncated),
                       values, passed)

    def close(self) -> None:
        """Let go of the environment."""
        self.env.close()

    def _guarded(self, act: Callable[[], Any]) -> Any:
        """Do something; what the environment raises becomes one line that names it."""
        try:
            return act()
        except Exception as error:
            raise SimulatorError(
                f'{self.description}: {type(error).__name__}: {plain(error)}') from error

    def _pixels(self, observation: Any) -> np.ndarray:
        pixels = np.asarray(self._guarded(lambda: self._picture(observation)))
        if pixels.ndim == 2:
            pixels = pixels[:, :, None]
        if (pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (1, 3)
                or not pixels.size):
            raise SimulatorError(
                f'{self.description}: its {self._settings.picture} picture is {pixels.dtype} of '
                f'shape {pixels.shape}; accepted: uint8 (H, W), (H, W, 1) or (H, W, 3)')
        if pixels.shape[2] == 1:
            pixels = pixels.repeat(3, axis=2)
        if self._crop is not None:
            pixels = cropped('picture_crop', pixels, self._crop, SimulatorError)
        if self._size is not None and self._size != (pixels.shape[1], pixels.shape[0]):
            pixels = resized(pixels, *self._size)
        return np.array(pixels)

    def _values(self, observation: Any, info: Mapping[str, Any]) -> dict[str, float | None]:
        places = {'info': info, 'observation': observation}
        return {name: _number(places, source.path) for name, source in self._sources.items()}


class _OneOfMany(gymnasium.Env):
    """A vector environment of one copy as a single one."""

    def __init__(self, many: Any) -> None:
        self._many = many
        self.action_space = many.single_action_space
        self.observation_space = many.single_observation_space
        self.metadata = many.metadata
        self.render_mode = many.render_mode
        self.spec = many.spec

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        observations, infos = self._many.reset(seed=seed, options=options)
        return _first(observations), _first(infos)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        actions = gymnasium.vector.utils.concatenate(
            self.action_space, [action],
            gymnasium.vector.utils.create_empty_array(self.action_space, 1))
        observations, rewards, terminated, truncated, infos = self._many.step(actions)
        return (_first(observations), float(rewards[0]), bool(terminated[0]), bool(truncated[0]),
                _first(infos))

    def render(self) -> Any:
        frames = self._many.render()
        return frames[0] if isinstance(frames, (tuple, list)) else frames

    def close(self) -> None:
        self._many.close()


def _first(batch: Any) -> Any:
    """Return what belongs to the first copy of a batch, however it is nested."""
    if isinstance(batch, Mapping):
        return {name: _first(value) for name, value in batch.items()}
    if isinstance(batch, tuple):
        return tuple(map(_first, batch))
    # arrays of whatever library
    return batch[0] if getattr(batch, 'ndim', 0) else batch


def _make(settings: GymnasiumEnvSettings) -> gymnasium.Env:
    name = settings.environment
    if not name:
        raise SimulatorError('environment is empty; expected an id of Gymnasium, such as '
                             'Pendulum-v1')
    options = load_yaml(settings.environment_options, 'environment_options', SimulatorError) or {}
    if not isinstance(options, dict) or not all(isinstance(one, str) for one in options):
        raise SimulatorError('environment_options must be a mapping of names to values')
    wanted = dict(options)
    if settings.picture == RENDERED:
        if options.get('render_mode', RENDER_MODE) != RENDER_MODE:
            raise SimulatorError(f'environment_options: render_mode is '
                                 f'{plain(options["render_mode"])!r}; accepted with picture '
                                 f'{RENDERED}: {RENDER_MODE!r}')
        wanted['render_mode'] = RENDER_MODE
    if settings.max_episode_frames:
        wanted['max_episode_steps'] = settings.max_episode_frames
    if ':' in name:
        look_here()
    # what it says through its own logger on the way, such as that a newer version exists
    logging.captureWarnings(True)
    try:
        make = _make_vector if settings.vectorized else gymnasium.make
        return make(name, **wanted)
    except SimulatorError:
        raise
    except Exception as error:
        # an environment may raise anything, and most of it is a name or an option that is wrong
        raise SimulatorError(
            f'gymnasium.make({plain(name)!r}): {type(error).__name__}: {plain(error)}') from None


def _make_vector(name: str, **wanted: Any) -> gymnasium.Env:
    """Return one copy of a vector environment; raises as `make_vec` does, and SimulatorError."""
    modes = gymnasium.vector.AutoresetMode
    try:
        return _OneOfMany(gymnasium.make_vec(
            name, num_envs=1, vectorization_mode='sync',
            vector_kwargs={'autoreset_mode': modes.DISABLED}, **wanted))
    except gymnasium.error.Error as error:
        try:
            many = gymnasium.make_vec(
                name, num_envs=1, vectorization_mode='vector_entry_point', **wanted)
        except gymnasium.error.Error:
            # it is not for want of one of its kind alone
            raise error from None
    if many.metadata.get('autoreset_mode') is modes.SAME_STEP:
        many.close()
        raise SimulatorError(f'{plain(name)} begins the next episode in the step that ends one '
                             '(autoreset SAME_STEP), so that no end can be seen: it cannot be '
                             'driven')
    return _OneOfMany(many)


def _picture_of(env: gymnasium.Env, picture: str) -> Callable[[Any], Any]:
    """Return what takes the picture, given the observation."""
    if picture == RENDERED:
        if env.render_mode != RENDER_MODE:
            raise SimulatorError(f'it does not render: its modes are '
                                 f'{", ".join((env.metadata or {}).get("render_modes", []))}')
        return lambda _: env.render()
    kind, *path = picture.split('.')
    if kind != OBSERVATION:
        raise SimulatorError(f'picture is {plain(picture)!r}; accepted: {RENDERED}, '
                             f'{OBSERVATION}, {OBSERVATION}.NAME')
    space = env.observation_space
    for name in path:
        if not isinstance(space, gymnasium.spaces.Dict) or name not in space.spaces:
            raise SimulatorError(f'picture: there is no {plain(name)!r} in the observation')
        space = space[name]
    shape, dtype = getattr(space, 'shape', None), getattr(space, 'dtype', None)
    if dtype != np.uint8 or len(shape or ()) not in (2, 3):
        raise SimulatorError(f'its observation is no image but {plain(space)}: picture: '
                             f'{RENDERED} takes what it renders')

    def take(observation: Any) -> Any:
        for name in path:
            observation = observation[name]
        return observation
    return take


def _size_of(text: str) -> tuple[int, int] | None:
    if not text:
        return None
    sides = tuple(map(int, text.split('x'))) if SIZE.fullmatch(text) else ()
    if not sides or not 1 <= min(sides) <= max(sides) <= MAX_SIDE:
        raise SimulatorError(f'picture_size is {plain(text)!r}; accepted: WIDTHxHEIGHT in pixels, '
                             f'sides of 1 to {MAX_SIDE}')
    return sides


class _Source(NamedTuple):
    """Where a value of `info` comes from."""

    text: str
    path: tuple[str, ...]
    needed: bool


def _sources_of(text: str) -> dict[str, _Source]:
    mapping = load_yaml(text, 'info', SimulatorError) or {}
    if not isinstance(mapping, dict):
        raise SimulatorError('info must be a mapping of names to info.PATH or observation.PATH')
    sources = {}
    for name, source in mapping.items():
        path = tuple(str(source).removesuffix('?').split('.'))
        if not isinstance(name, str) or path[0] not in ('info', OBSERVATION) or len(path) < 2:
            raise SimulatorError(f'info: {plain(name)} is {plain(source)!r}; accepted: info.PATH '
                                 'or observation.PATH')
        sources[name] = _Source(str(source), path, not source.endswith('?'))
    return sources


def _names_in(info: Any) -> str:
    names = ', '.join(map(str, info)) if isinstance(info, Mapping) else ''
    return names or 'nothing'


def _number(places: Mapping[str, Any], path: tuple[str, ...]) -> float | None:
    """Return the finite number at a path, or None."""
    value: Any = places
    try:
        for part in path:
            value = value[part] if isinstance(value, Mapping) else value[int(part)]
        number = float(value)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None
