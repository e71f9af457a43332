# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's car: its tracks, its physics, its pictures, and the node around it."""
import hashlib
import os
import subprocess
import sys

from carracing_dqn.simulation.registry import make_simulator
from carracing_dqn.simulators import mujoco_world as world
from graph_probe import carracing, ROOT
from msgs_bridge import topics
from msgs_bridge.errors import SimulatorError
from msgs_bridge.twists import Command
from mujoco_driver import pursue
import numpy as np
import pytest

try:
    make_simulator('mujoco').close()
except SimulatorError as error:
    pytest.skip(str(error), allow_module_level=True)

DRIVE = """
import hashlib, sys
from carracing_dqn.simulation.registry import make_simulator
from msgs_bridge.twists import Command
import numpy as np
simulator = make_simulator(sys.argv[1])
random, digest = np.random.default_rng(5), hashlib.sha256()
for seed in (7, None):
    outcome = simulator.reset(seed)
    for _ in range(60):
        outcome = simulator.advance(Command(*random.uniform(-0.4, 1, 2)), 2)
        digest.update(outcome.pixels.tobytes())
        digest.update(repr((outcome.reward, *outcome.info.values())).encode())
print(digest.hexdigest())
"""


@pytest.fixture
def car():
    simulator = make_simulator('mujoco_car')
    yield simulator
    simulator.close()


def test_a_driver_who_knows_the_map_completes_laps_on_ten_tracks(car):
    lengths = set()
    for seed in range(10):
        outcome, total, touched = car.reset(seed), 0.0, 0.0
        while not (outcome.terminated or outcome.truncated):
            outcome = car.advance(pursue(car.track, car.pose, car.motion[0]), 5)
            total += outcome.reward
            touched += outcome.info['contact']
        assert outcome.terminated and outcome.info['lap_finished'] == 1, seed
        assert outcome.info['progress'] >= 0.95 and touched == 0
        assert total > 900
        lengths.add(len(car.track))
    assert len(lengths) > 3, 'the tracks of seeds are all the same'


@pytest.mark.parametrize('profile', ['mujoco_car', 'mujoco_bonnet'])
def test_same_seed_and_commands_are_the_same_bytes_in_any_process(profile):
    told = [subprocess.run([sys.executable, '-c', DRIVE, profile], capture_output=True, text=True,
                           cwd=ROOT, check=True).stdout for _ in range(2)]
    assert told[0] == told[1] and len(told[0].strip()) == 64


def test_a_seed_is_the_same_whatever_was_driven_before(car):
    def digest():
        outcome, found = car.reset(11), hashlib.sha256()
        for _ in range(40):
            found.update(outcome.pixels.tobytes())
            outcome = car.advance(Command(0.8, 0.3))
        return found.digest()

    first = digest()
    car.reset(12)
    car.advance(Command(1.0, -1.0), 30)
    assert digest() == first


def test_passing_over_tracks_leads_to_the_same_ones(car):
    car.reset(3)
    for _ in range(3):
        pixels = car.reset(None).pixels
    car.skip(3, 3)
    assert np.array_equal(car.reset(None).pixels, pixels)


def test_left_is_left_and_negative_brakes_and_goes_back(car):
    car.reset(1)
    yaw = car.pose[2]
    car.advance(Command(0.5, 1.0), 15)
    assert 0.1 < (car.pose[2] - yaw + np.pi) % (2 * np.pi) - np.pi < 3
    car.reset(1)
    fast = car.advance(Command(1.0, 0.0), 12).info['speed']
    slower = car.advance(Command(-1.0, 0.0), 4).info['speed']
    back = car.advance(Command(-1.0, 0.0), 40).info['speed']
    assert fast > 1 and 0.9 * fast > slower > 0 > back
    assert world.steering_angles(0.0) == (0.0, 0.0)
    left, right = world.steering_angles(1.0)
    assert left > world.STEERING_LIMIT > right > 0


def test_who_drives_off_touches_walls_slows_down_on_grass_and_leaves_the_field(car):
    seen = set()
    for seed in range(6):
        outcome, total, fastest = car.reset(seed), 0.0, 0.0
        while not (outcome.terminated or outcome.truncated):
            outcome = car.advance(Command(0.6, 0.0), 4)
            fastest = max(fastest, outcome.info['speed'])
            total += outcome.reward
            if outcome.info['off_road']:
                seen.add('off road')
                if outcome.info['speed'] < 0.7 * fastest:
                    seen.add('slow')
            if outcome.info['contact']:
                seen.add('wall')
        if outcome.info['left_field']:
            seen.add('left')
            assert outcome.terminated and total < 500 and outcome.info['lap_finished'] == 0
    assert seen >= {'off road', 'slow', 'wall', 'left'}


def test_both_pictures_show_road_grass_and_car(car):
    pixels = car.reset(0).pixels.astype(int)
    assert pixels.shape == (96, 96, 3)
    red, green, blue = pixels.transpose(2, 0, 1)
    grass = (green > red + 40) & (green > blue + 40)
    road = (abs(red - green) < 8) & (abs(green - blue) < 8) & (green > 70) & (green < 130)
    assert grass.mean() > 0.3 and road.mean() > 0.1
    # the car is in the middle of the lower half, on the road
    body = ((red > 150) & (green < 80))[60:90, 38:58]
    rows, columns = np.nonzero(body)
    assert 8 <= body.sum() <= 40 and abs(columns.mean() - 9.5) < 2
    assert road[60:85, 40:44].all() and road[60:85, 52:55].all()
    bonnet = make_simulator('mujoco_bonnet')
    red, green, blue = bonnet.reset(0).pixels.astype(int).transpose(2, 0, 1)
    bonnet.close()
    assert (blue[:15] > green[:15]).all(), 'the sky'
    assert abs(red[60, 40:56] - green[60, 40:56]).max() < 8, 'the road'


def test_the_rules_end_an_episode_and_a_robot_has_none():
    short = make_simulator('mujoco_car', {'max_episode_frames': 10})
    short.reset(0)
    outcome = short.advance(Command(0.1, 0.0), 50)
    assert (outcome.truncated, outcome.terminated, outcome.frames) == (True, False, 10)
    short.close()
    robot = make_simulator('mujoco_robot', {'max_episode_frames': 10})
    robot.reset(0)
    outcome = robot.advance(Command(0.6, 0.0), 400)
    assert outcome.frames == 400 and outcome.reward == 0 and not outcome.terminated
    robot.close()


def test_the_variant_for_training_ends_an_episode_that_earns_nothing():
    simulator = make_simulator('mujoco_car', {'early_end_frames': 20})
    simulator.reset(3)
    outcome = simulator.advance(Command(0.0, 0.0), 100)
    assert (outcome.frames, outcome.truncated, outcome.terminated) == (20, True, False)
    assert outcome.info['ended_early'] == 1
    simulator.reset(3)
    outcome = simulator.advance(Command(0.6, 0.0), 30)
    assert outcome.frames == 30 and outcome.info['ended_early'] == 0 and outcome.reward > 0
    simulator.close()


@pytest.mark.parametrize(('values', 'told'), [
    ({'camera': 'side'}, 'camera'), ({'picture_width': 4}, 'picture_width'),
    ({'max_episode_frames': 0}, 'max_episode_frames'), ({'zoom': True}, "unknown setting 'zoom'")])
def test_what_is_not_accepted_is_refused_in_one_line(values, told):
    with pytest.raises(Exception, match=told) as caught:
        make_simulator('mujoco_car', values)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('environment', 'told'), [
    ({'MUJOCO_GL': 'nothing'}, 'invalid value for environment variable MUJOCO_GL'),
    ({'MUJOCO_GL': 'egl', 'EGL_PLATFORM': 'surfaceless', '__EGL_VENDOR_LIBRARY_DIRS': '/nowhere'},
     'libegl1')])
def test_where_nothing_can_be_drawn_one_line_says_what_to_install(environment, told):
    result = subprocess.run(
        [sys.executable, '-m', 'carracing_sim_node', '--ros-args', '-p',
         'simulator:=mujoco_car'], capture_output=True, text=True, cwd=ROOT, timeout=60,
        env={**os.environ, **environment})
    errors = [line for line in result.stderr.splitlines() if line.startswith('error: ')]
    assert result.returncode == 2 and len(errors) == 1, result.stderr
    assert told in errors[0] and 'apt-get install' in errors[0]
    assert 'Traceback' not in result.stderr


def test_without_mujoco_one_line_says_how_to_install_it():
    hidden = ("import sys; sys.modules['mujoco'] = None; "
              "from carracing_dqn.simulation.registry import make_simulator; "
              "make_simulator('mujoco_car')")
    result = subprocess.run([sys.executable, '-c', hidden], capture_output=True, text=True,
                            cwd=ROOT)
    assert result.stderr.splitlines()[-1] == (
        "msgs_bridge.errors.SimulatorError: mujoco is not installed: "
        "pip install 'carracing_dqn[mujoco]' (or pip install mujoco)")


def test_some_hundred_steps_over_topics(graph):
    graph.listen(topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.EPISODE)
    graph.node('dqn_policy_node', 'dqn_policy_node', model='random', wait_for_subscribers=2)
    graph.node('carracing_sim_node', 'carracing_sim_node', simulator='mujoco_car', seed=3,
               seed_each_episode=True, max_episode_frames=150, action_repeat=2,
               wait_for_subscribers=1)
    graph.spin_until(lambda: len(graph.messages['step']) > 250, 60, 'driving')
    joined, joiner = graph.join()
    assert len(joined) >= 200 and not joiner.counts['lost_image'] + joiner.counts['lost_twist']
    simulator = make_simulator('mujoco_car', {'max_episode_frames': 150})
    for transition in joined[:160]:
        if transition.previous.decision == 0:
            outcome = simulator.reset(3 + transition.previous.episode)
        assert np.array_equal(transition.frame, outcome.pixels)
        outcome = simulator.advance(transition.command, 2)
        assert np.array_equal(transition.next_frame, outcome.pixels)
        assert transition.step.reward == outcome.reward
        assert transition.step.info.items() >= outcome.info.items()
    simulator.close()


def test_a_bag_of_it_is_driven_again(tmp_path):
    result = carracing('run', '--simulator', 'mujoco_car', '--model', 'random', '--laps', '1',
                       '--output', str(tmp_path / 'run'), timeout=180)
    assert result.returncode == 0, result.stdout + result.stderr
    # its tiles are none of CarRacing's, on whose tracks laps are drawn
    assert not (tmp_path / 'run' / 'pictures').exists()
    result = carracing('bag', 'verify', str(tmp_path / 'run' / 'bag'), timeout=180)
    assert result.returncode == 0, result.stdout + result.stderr
    assert '1001 frames, 0 differ' in result.stdout
