# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Environments of Gymnasium as simulators: an id and a mapping, nothing else."""
from __future__ import annotations

import importlib.util
from pathlib import Path
import sys
import types

from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.policies import parse_policy
from carracing_dqn.simulation import Drive, find_simulator, make_simulator
from carracing_dqn.simulation.profiles import (
    found_from, load_profile, profile_names, seen_from,
)
from carracing_dqn.simulation.settings import settings_for
from carracing_dqn.simulators.gymnasium_env import GymnasiumEnv
from carracing_dqn.simulators.space_mapping import action_encoder
import gymnasium
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings as hypothesis_settings, strategies
from msgs_bridge.errors import SettingsError, SimulatorError
from msgs_bridge.share import share_path
from msgs_bridge.twists import Command
import numpy as np
import pytest

NEAREST = {'nearest': [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]}
SPACES = [
    (spaces.Box(-2, 2, (1,)), {'angular': 3.0}, [2.0]),
    (spaces.Box(np.array([-1, 0, 0], np.float32), np.array([1, 1, 1], np.float32)),
     [{'angular': -1}, {'linear': 1}, {'linear': -1}], [-0.75, 0.5, 0.0]),
    (spaces.Box(0, 255, (2,), np.uint8), [{'offset': 7}, {'linear': 1000}], [7, 255]),
    (spaces.Discrete(3, start=5), NEAREST, 6),
    (spaces.MultiDiscrete([3, 3]), [NEAREST, NEAREST], [1, 1]),
    (spaces.MultiBinary(1), [{'nearest': [[0, 0], [0, 1]]}], [1]),
    (spaces.Tuple([spaces.Discrete(3), spaces.Box(-1, 1, (1,))]), [NEAREST, {'linear': 1}],
     (1, [0.5])),
    (spaces.Dict(gas=spaces.Box(0, 1, (1,)), gear=spaces.Discrete(3)),
     {'gas': {'linear': 1}, 'gear': NEAREST}, {'gas': [0.5], 'gear': 1}),
]


@pytest.mark.parametrize(('space', 'mapping', 'expected'), SPACES)
def test_a_command_becomes_an_action_of_any_space(space, mapping, expected):
    action = action_encoder(space, mapping)(Command(0.5, 0.75))
    assert space.contains(action)
    flat = spaces.flatten(space, action)
    if isinstance(expected, tuple):
        wanted = (expected[0], np.array(expected[1], np.float32))
    elif isinstance(expected, dict):
        wanted = {'gas': np.array(expected['gas'], np.float32), 'gear': expected['gear']}
    elif isinstance(expected, int):
        wanted = expected
    else:
        wanted = np.array(expected, space.dtype)
    assert np.array_equal(flat, spaces.flatten(space, wanted))


@pytest.mark.parametrize(('space', 'linear', 'expected'), [
    (spaces.Box(-2, 2, (1,), np.int8), 0.9, 2), (spaces.Box(-2, 2, (1,), np.int8), 0.2, 0),
    (spaces.Box(-2, 2, (1,), np.int8), -0.9, -2), (spaces.Box(0, 255, (1,), np.uint8), 1.0, 2),
    (spaces.Box(-2**63, 2**63 - 2, (1,), np.int64), 1.0, 2)])
def test_whole_numbers_are_the_nearest(space, linear, expected):
    action = action_encoder(space, {'linear': 2.0})(Command(linear, 0.0))
    assert space.contains(action) and action == expected
    # and those beyond all bounds are the bounds
    for weight, bound in ((1e300, space.high), (-1e300, space.low)):
        assert action_encoder(space, {'linear': weight})(Command(1.0, 0.0)) == bound


@hypothesis_settings(deadline=None, max_examples=50)
@given(linear=strategies.floats(-1, 1), angular=strategies.floats(-1, 1),
       number=strategies.integers(0, len(SPACES) - 1))
def test_every_command_is_an_action(linear, angular, number):
    space, mapping, _ = SPACES[number]
    assert space.contains(action_encoder(space, mapping)(Command(linear, angular)))


@pytest.mark.parametrize(('space', 'mapping', 'told'), [
    (spaces.Box(-2, 2, (2,)), [{'linear': 1}], 'action must be a list of 2'),
    (spaces.Box(-2, 2, (1,)), {'lineal': 1}, 'action.0. must be a mapping of linear, angular'),
    (spaces.Box(-2, 2, (1,)), {'linear': float('nan')}, 'finite'),
    (spaces.Box(-2, 2, (1,)), {'linear': 'x'}, 'finite'),
    (spaces.Discrete(3), None, 'a list of 3 commands'),
    (spaces.Discrete(3), {'nearest': [[0, 0]]}, 'a list of 3 commands'),
    (spaces.Discrete(1), {'nearest': [[0, 'x']]}, 'two numbers'),
    (spaces.Discrete(1), {'nearest': [[0]]}, 'two numbers'),
    (spaces.Tuple([spaces.Discrete(3)]), {}, 'action must be a list of 1'),
    (spaces.Tuple([spaces.Discrete(3)]), [7], r'action\[0\] must be nearest'),
    (spaces.Dict(a=spaces.Discrete(3)), {'b': NEAREST}, 'action must map a'),
    (spaces.Text(3), {}, 'no command can be made an action of Text'),
])
def test_a_mapping_that_does_not_fit_is_told_in_one_line(space, mapping, told):
    with pytest.raises(SimulatorError, match=told) as error:
        action_encoder(space, mapping)
    assert '\n' not in str(error.value)


def made(**settings):
    kind = find_simulator('gymnasium_env')
    return kind(kind.Settings(**{
        'environment': 'Pendulum-v1', 'action': '{angular: 2.0}', **settings}))


def trajectory(simulator, seed, steps=30):
    try:
        outcomes = [simulator.reset(seed)]
        outcomes += [simulator.advance(Command(0.0, np.sin(step))) for step in range(steps)]
    finally:
        simulator.close()
    return [(one.pixels.tobytes(), *one[1:4], dict(one.info)) for one in outcomes]


@pytest.mark.parametrize('settings', [
    {}, {'vectorized': True}, {'picture_size': '40x30', 'picture_crop': '100,100,300,200'}])
def test_the_same_seed_and_commands_give_the_same_outcomes(settings):
    info = '{speed: observation.2}'
    assert trajectory(made(info=info, **settings), 3) == trajectory(made(info=info, **settings), 3)
    assert trajectory(made(info=info, **settings), 3) != trajectory(made(info=info, **settings), 4)


def test_one_copy_of_a_vector_environment_is_the_environment():
    assert trajectory(made(vectorized=True), 3) == trajectory(made(), 3)


def test_an_observation_can_be_the_picture():
    simulator = made(environment='CarRacing-v3', picture='observation', picture_size='',
                     action='[{angular: -1}, {linear: 1}, {linear: -1}]', max_episode_frames=3)
    ours = make_simulator('gymnasium', {'max_episode_frames': 3})
    try:
        assert np.array_equal(simulator.reset(5).pixels, ours.reset(5).pixels)
        assert simulator.frame_seconds == ours.frame_seconds
        ours_then, then = (one.advance(Command(0.5, 0.25), 4) for one in (ours, simulator))
        assert np.array_equal(then.pixels, ours_then.pixels)
        assert then[1:4] == ours_then[1:4]
        assert then.frames == 3 and then.truncated
    finally:
        simulator.close()
        ours.close()


@pytest.mark.parametrize(('settings', 'told'), [
    ({'environment': ''}, 'environment is empty'),
    ({'environment': 'Nowhere-v0'}, "Environment `Nowhere` doesn't exist"),
    ({'environment': 'no_such_module:A-v0'}, 'no_such_module'),
    ({'environment_options': '[1]'}, 'a mapping of names to values'),
    ({'environment_options': '{'}, 'not valid YAML'),
    ({'environment_options': '{no_such_option: 1}'}, 'no_such_option'),
    ({'environment_options': '{render_mode: human}'}, "render_mode is 'human'; accepted"),
    ({'environment': 'MountainCar-v0', 'action': '{nearest: [[0, 0]]}'}, 'a list of 3 commands'),
    ({'picture': 'observation'}, 'its observation is no image'),
    ({'picture': 'observation.camera'}, "no 'camera' in the observation"),
    ({'picture': 'sky'}, 'accepted: rendered, observation'),
    ({'picture_size': '96'}, 'WIDTHxHEIGHT'),
    ({'picture_size': '0x9'}, 'sides of 1 to'),
    ({'picture_crop': '1,2,3'}, 'LEFT,TOP,WIDTH,HEIGHT'),
    ({'info': '[speed]'}, 'info must be a mapping'),
    ({'info': '{speed: 3}'}, 'accepted: info.PATH'),
])
def test_bad_settings_are_one_line_before_anything_starts(settings, told):
    with pytest.raises(SimulatorError, match=told) as error:
        made(**settings)
    assert '\n' not in str(error.value)


def test_a_value_that_is_not_there_is_named_and_one_that_may_be_missing_is_zero():
    simulator = made(info='{speed: info.velocity}')
    simulator.reset(1)
    with pytest.raises(SimulatorError, match='speed: info.velocity is no number'):
        simulator.advance(Command(0, 0))
    simulator = made(info='{speed: "info.velocity?"}')
    assert simulator.reset(1).info == simulator.advance(Command(0, 0)).info == {'speed': 0.0}


def test_a_crop_that_does_not_fit_is_told():
    with pytest.raises(SimulatorError, match='does not fit on an image of 500x500'):
        made(picture_crop='400,400,200,200').reset(1)


class Raises(gymnasium.Env):
    """An environment that fails in its second step."""

    metadata = {'render_modes': ['rgb_array'], 'render_fps': 10}
    action_space = spaces.Box(-1, 1, (1,))
    observation_space = spaces.Box(-1, 1, (1,))

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        if self.steps == 2:
            raise RuntimeError('the engine\nblew up')
        return np.zeros(1, np.float32), 0.0, False, False, {}

    def render(self):
        return np.zeros((20, 20, 3), np.uint8)


def test_what_an_environment_raises_is_one_line_that_names_it():
    gymnasium.register('Raises-v0', entry_point=Raises)
    simulator = made(environment='Raises-v0')
    simulator.reset(0)
    with pytest.raises(SimulatorError, match='Raises-v0.*RuntimeError: the engine.blew up'):
        simulator.advance(Command(0, 0), 5)


class Camera(Raises):
    """An image is all that it gives; it has no render_mode, and cannot be closed."""

    observation_space = spaces.Box(0, 255, (20, 20), np.uint8)
    info = {'speed': 10**400}

    def __init__(self):
        super().__init__()
        self.drawn = np.zeros((20, 20), np.uint8)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.drawn[:] = 0
        return self.drawn, self.info

    def step(self, action):
        self.drawn += 1
        return self.drawn, np.float32(0.1), np.False_, np.False_, self.info

    def close(self):
        raise ConnectionError('nobody is there')


def test_an_environment_that_cannot_render_is_seen_by_its_observation():
    gymnasium.register('Camera-v0', entry_point=Camera)
    settings = {'environment': 'Camera-v0', 'picture': 'observation', 'picture_size': '',
                'action': '{linear: 1}'}
    simulator = made(**settings, info='{speed: "info.speed?"}')
    frames = [simulator.reset(1), *(simulator.advance(Command(0, 0)) for _ in range(3))]
    # it draws into one array
    assert [frame.pixels[0, 0].tolist() for frame in frames] == [[n] * 3 for n in range(4)]
    assert frames[-1].reward == np.float32(0.1) and frames[-1].info == {'speed': 0.0}
    with pytest.raises(SimulatorError, match='speed: info.speed is no number'):
        simulator = made(**settings, info='{speed: info.speed}')
        simulator.reset(1)
        simulator.advance(Command(0, 0))
    # what is told is why it was closed, not that it could not be
    with pytest.raises(SimulatorError, match='must be a mapping of linear'):
        made(**{**settings, 'action': '{lineal: 1}'})


def available(name):
    """Return a profile's simulator, or skip where its extra is missing."""
    try:
        return make_simulator(name)
    except SimulatorError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize('name', profile_names())
def test_shipped_profiles_are_driven_and_keep_what_they_promise(name):
    profile = load_profile(share_path(f'config/simulators/{name}.yaml'))
    assert profile.about
    if not profile.simulator:
        return
    simulator = available(name)
    if isinstance(simulator, GymnasiumEnv):
        check_env(simulator.env.unwrapped, skip_render_check=True)
    settings = settings_for(name)(simulator=name, seed=3, seed_each_episode=True)
    drive = Drive(simulator, settings)
    frame = drive.begin()
    for step in range(20):
        frame = drive.advance(Command(0.3, np.sin(step)), None)
        if frame.step.ended:
            break
    assert np.ptp(frame.pixels) > 0
    drive.close()
    if profile.deterministic:
        assert trajectory(make_simulator(name), 3, 10) == trajectory(make_simulator(name), 3, 10)


@pytest.mark.parametrize(('text', 'told'), [
    ('[]', 'a profile is a mapping'),
    ('nothing: 1', "unknown setting 'nothing'"),
    ('simulator: 3', 'simulator must be a text'),
    ('settings: [1]', 'settings must be a mapping'),
    ('settings: {1: 2}', 'settings must be a mapping of names'),
    ('simulator: gymnasium_env\nsettings: {envirnment: x}', "did you mean 'environment'"),
    ('simulator: gymnasium_env\nsettings: {vectorized: 3}', 'vectorized must be true or false'),
    ('simulator: nowhere', "simulator is 'nowhere'"),
    ('simulator: gymnasium_env\nneeds: {os.path: x}', 'needs: os.path cannot be'),
    ('simulator: pendulum', 'a profile itself'),
    ('about: a robot', 'it names no simulator'),
    ('a: &a [1]\nb: *a', 'aliases are not accepted'),
])
def test_a_profile_that_is_none_is_one_line(tmp_path, text, told):
    path = tmp_path / 'car.yaml'
    path.write_text(text)
    with pytest.raises((SettingsError, SimulatorError), match=told) as error:
        find_simulator(str(path))
    assert '\n' not in str(error.value)


def test_what_a_profile_needs_is_said_with_how_to_install_it(tmp_path, monkeypatch):
    path = tmp_path / 'car.yaml'
    path.write_text('simulator: gymnasium_env\nneeds: {no_such_module: pip install it}\n')
    with pytest.raises(SimulatorError, match='car: no_such_module is not installed: pip install'):
        make_simulator(str(path))
    # one that is there, and from nowhere
    monkeypatch.setitem(sys.modules, 'from_nowhere', types.ModuleType('from_nowhere'))
    path = tmp_path / 'other.yaml'
    path.write_text('simulator: carracing\nneeds: {from_nowhere: pip install it}\n')
    assert find_simulator(str(path))


def test_a_profile_that_is_no_file_is_one_line(tmp_path):
    with pytest.raises(SettingsError, match='no such file'):
        find_simulator(str(tmp_path / 'none.yaml'))
    with pytest.raises(SimulatorError, match='accepted: carracing'):
        find_simulator('../pendulum')


def test_a_profile_by_path_is_found_from_the_folder_of_a_run_and_names_no_home(
    tmp_path, monkeypatch,
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'car.yaml').write_text('simulator: pendulum')
    run = tmp_path / 'runs' / 'new'
    for typed in ('car.yaml', './car.yaml', str(tmp_path / 'car.yaml')):
        seen = seen_from(typed, run)
        assert seen == '../../car.yaml'
        assert Path(found_from(seen, run)) == tmp_path / 'car.yaml'
        assert found_from(seen, 'runs/new') == 'car.yaml'
    for name in ('carracing', 'pendulum', 'module:Class', 'x' * 5000):
        assert seen_from(name, run) == found_from(name, run) == name


def test_a_yaml_file_is_all_that_a_fourth_environment_needs(tmp_path):
    path = tmp_path / 'mountain.yaml'
    path.write_text(
        'simulator: gymnasium_env\n'
        'settings: {environment: MountainCarContinuous-v0, action: {linear: 1.0},\n'
        '           info: {position: observation.0}, max_episode_frames: 12}\n')
    laps = list(drive_laps(parse_policy('random', ''), [1, 2], simulator=str(path)))
    assert [lap.frames for lap in laps] == [12, 12]
    assert all(lap.episode_return < 0 for lap in laps)


@pytest.mark.skipif(importlib.util.find_spec('highway_env') is None,
                    reason="highway-env is missing: pip install 'carracing_dqn[highway]'")
def test_left_is_left_on_the_racetrack():
    positions = []
    for angular in (1.0, -1.0):
        simulator = make_simulator('racetrack')
        simulator.reset(1)
        heading = simulator.env.unwrapped.vehicle.heading
        for _ in range(3):
            simulator.advance(Command(0.0, angular))
        positions.append(simulator.env.unwrapped.vehicle.heading - heading)
        simulator.close()
    # y points down there, so that a turn to the left makes the heading less
    assert positions[0] < 0 < positions[1]
