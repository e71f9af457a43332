# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators that others wrote, where they are odd or broken."""
from __future__ import annotations

import ctypes.util
import sys
import types

from carracing_dqn.simulation.drive import open_drive
from carracing_dqn.simulation.profiles import load_profile
from carracing_dqn.simulation.registry import find_simulator
from carracing_dqn.simulators.mujoco_picture import load_mujoco
from carracing_dqn.simulators.pyracerz_views import RawView
from carracing_sim_node.appearance import CAR_ROW
import gymnasium
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from msgs_bridge.errors import SettingsError, SimulatorError
from msgs_bridge.twists import Command
import numpy as np
import pygame
import pytest


class Many(VectorEnv):
    """An environment that exists as a vector alone, and counts its steps."""

    metadata = {'render_modes': ['rgb_array'], 'render_fps': 10,
                'autoreset_mode': AutoresetMode.NEXT_STEP}
    single_action_space = spaces.Box(-1, 1, (1,))
    single_observation_space = spaces.Box(-9, 9, (2,))

    def __init__(self, num_envs, render_mode=None, max_episode_steps=4):
        self.num_envs, self.render_mode, self.most = num_envs, render_mode, max_episode_steps
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.zeros((1, 2), np.float32), {}

    def step(self, actions):
        self.steps += 1
        # such as those of other libraries, which are no arrays of numpy and take any index
        return (Batch([[0.0, self.steps]]), np.array([float(actions[0, 0])]), np.zeros(1, bool),
                np.array([self.steps >= self.most]), {'steps': np.array([self.steps])})

    def render(self):
        return (np.full((20, 20, 3), self.steps, np.uint8),)


class Batch:
    """An array of another library, which is lenient with indices beyond its end."""

    ndim = 2

    def __init__(self, rows):
        self.rows = rows

    def __getitem__(self, index):
        return self.rows[min(index, len(self.rows) - 1)]


class Hasty(Many):
    """One that begins anew before anybody has seen the end."""

    metadata = {**Many.metadata, 'autoreset_mode': AutoresetMode.SAME_STEP}


class Blind(gymnasium.Env):
    """One whose pictures have no rows."""

    metadata = {'render_modes': ['rgb_array'], 'render_fps': 10}
    action_space = spaces.Box(-1, 1, (1,))
    observation_space = spaces.Box(-1, 1, (1,))

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def render(self):
        return np.zeros((0, 20, 3), np.uint8)


for one in (Many, Hasty):
    gymnasium.register(f'{one.__name__}-v0', vector_entry_point=one, max_episode_steps=4)
gymnasium.register('Blind-v0', entry_point=Blind)


def opened(environment, **settings):
    return open_drive({'simulator': 'gymnasium_env', 'environment': environment,
                       'action': '{linear: 1}', **settings})


def test_an_environment_that_exists_as_a_vector_alone_is_driven():
    drive = opened('Many-v0', vectorized=True, info='{n: observation.1, steps: info.steps}')
    for _ in range(2):
        drive.begin()
        frames = [drive.advance(Command(0.5, 0.2), None) for _ in range(4)]
        for number, frame in enumerate(frames, 1):
            assert frame.step.info['n'] == frame.step.info['steps'] == frame.pixels[0, 0, 0]
            assert frame.step.info['n'] == number and frame.step.reward == 0.5
        assert [frame.step.truncated for frame in frames] == [False] * 3 + [True]
    drive.close()


def test_an_environment_in_a_module_of_this_folder_is_found(tmp_path, monkeypatch):
    """As `carracing` is called, whose own folder is another."""
    monkeypatch.setattr(sys, 'path', list(sys.path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'of_this_folder.py').write_text(
        'import gymnasium\n'
        "gymnasium.register('Here-v0', 'gymnasium.envs.classic_control:PendulumEnv')\n")
    drive = opened('of_this_folder:Here-v0', action='{angular: 2}')
    assert np.ptp(drive.begin().pixels) > 0
    drive.close()


@pytest.mark.parametrize(('environment', 'settings', 'told'), [
    ('Hasty-v0', {'vectorized': True}, 'SAME_STEP'),
    ('Nowhere-v0', {'vectorized': True}, "Nowhere` doesn't exist"),
    ('Blind-v0', {'vectorized': True, 'environment_options': '{zoom: 3}'}, 'zoom'),
    ('Blind-v0', {}, r'shape \(0, 20, 3\)')])
def test_what_cannot_be_driven_is_one_line(environment, settings, told):
    with pytest.raises(SimulatorError, match=told) as error:
        opened(environment, **settings).begin()
    assert '\n' not in str(error.value)


def test_a_value_of_a_profile_that_is_a_text_is_that_text(tmp_path):
    path = tmp_path / 'car.yaml'
    path.write_text('simulator: gymnasium_env\n'
                    'settings: {frame_id: 3, picture_size: 48, action: {linear: 1}, info: }\n')
    settings = find_simulator(str(path)).Settings()
    assert (settings.frame_id, settings.picture_size) == ('3', '48')
    assert (settings.action, settings.info) == ('linear: 1', 'null')


@pytest.mark.parametrize(('text', 'told'), [
    ('topics: {imge_raw: /front/image}', "did you mean 'image_raw'"),
    ('topics: {camera: /front/image}', "unknown setting 'camera'"),
    ('settings: {camera_turn: 90}', 'settings are those of a simulator.*under vehicle'),
    ('needs: {cv2: pip install opencv-python}', 'needs are those of a simulator'),
    ('camera: {patch: [4, 4, 0, 8]}', r'patch cannot be \[4, 4, 0, 8\]')])
def test_what_of_a_profile_has_no_effect_is_refused(tmp_path, text, told):
    path = tmp_path / 'car.yaml'
    path.write_text(text)
    with pytest.raises(SettingsError, match=told):
        load_profile(path)


@pytest.mark.parametrize(('scale', 'stretch'), [
    (0.5, 1.0), (1.0, 0.2), (0.5, 0.2), (4.0, 1.0), (20.0, 5.0)])
def test_a_car_of_pyracerz_is_drawn_from_as_near_as_is_accepted(scale, stretch):
    car = pygame.Surface((30, 30), pygame.SRCALPHA)
    car.fill((200, 10, 10, 255))
    road = pygame.Surface((400, 300))
    road.fill((90, 90, 90))
    view = RawView(road, types.SimpleNamespace(
        sizeRect=30, cars=[car] * 128, cars2=[car] * 128, x=200.0, y=150.0, angle=0.3, brake=0.0),
        scale, stretch)
    pixels = view.draw()
    assert pixels.shape == (96, 96, 3) and pixels.dtype == np.uint8
    assert pixels[CAR_ROW, 48].tolist() == [200, 10, 10]
    # as much of the picture as the car takes, as far as it reaches
    red = (pixels == (200, 10, 10)).all(2)
    half = 15 / scale / stretch
    assert red.any(0).sum() == pytest.approx(min(30 / scale, 96), abs=1)
    assert red.any(1).sum() == pytest.approx(min(half, CAR_ROW) + min(half, 96 - CAR_ROW), abs=1)


@pytest.fixture
def other_mujoco(tmp_path, monkeypatch):
    """Put a package in the place of MuJoCo, whose code is given."""
    for name in [one for one in sys.modules if one.partition('.')[0] == 'mujoco']:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv('MUJOCO_GL', raising=False)
    yield lambda code: (tmp_path / 'mujoco.py').write_text(code)
    sys.modules.pop('mujoco', None)


def test_a_broken_mujoco_is_not_said_to_lack_opengl_alone(other_mujoco):
    other_mujoco("raise ImportError(\"Version mismatch of 'mujoco-core'\\nUpgrade\")")
    with pytest.raises(SimulatorError, match='loaded .*mujoco-core.*--force-reinstall') as error:
        load_mujoco()
    assert '\n' not in str(error.value)


def test_a_screen_at_which_nobody_answers_is_not_needed(other_mujoco, monkeypatch):
    other_mujoco("import os; GLContext = os.environ.get('MUJOCO_GL')")
    monkeypatch.setenv('DISPLAY', ':77')
    monkeypatch.setattr(ctypes.util, 'find_library', {'EGL': 'libEGL.so.1'}.get)
    assert load_mujoco().GLContext == 'egl'
    # by a screen, where there is nothing else
    del sys.modules['mujoco']
    monkeypatch.delenv('MUJOCO_GL')
    monkeypatch.setattr(ctypes.util, 'find_library', {}.get)
    assert load_mujoco().GLContext is None
    monkeypatch.delenv('DISPLAY')
    with pytest.raises(SimulatorError, match='no OpenGL'):
        load_mujoco()
