# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""pyRacerz as a simulator, where the game is installed."""
import math
import sys

from carracing_dqn.simulation import make_simulator
from carracing_dqn.simulation.registry import find_simulator
from carracing_dqn.simulators import pyracerz_game
from graph_probe import carracing
from msgs_bridge.errors import SimulatorError
from msgs_bridge.twists import Command
import numpy as np
import pygame
import pytest

PROFILES = ('pyracerz_raw', 'pyracerz_carracing')
installed = pytest.mark.skipif(
    not pyracerz_game.FOLDER.is_dir(), reason='needs pyRacerz: apt-get install pyracerz')


def drive(simulator, seed, commands, *, frames=1):
    """Return everything that came of a start and some commands."""
    outcomes = [simulator.reset(seed)]
    for command in commands:
        outcomes.append(simulator.advance(command, frames))
        if outcomes[-1].terminated or outcomes[-1].truncated:
            break
    return [(one.pixels.tobytes(), one.reward, one.terminated, one.truncated, dict(one.info),
             one.frames) for one in outcomes]


def some_commands(count):
    random = np.random.default_rng(5)
    return [Command(float(linear), float(angular))
            for linear, angular in random.uniform((-0.3, -1), 1, (count, 2))]


@installed
@pytest.mark.parametrize('profile', PROFILES)
def test_seed_and_commands_make_the_same_outcomes_to_the_byte(profile):
    assert find_simulator(profile).deterministic
    commands = some_commands(60)
    simulator = make_simulator(profile, {'level': 2, 'start_variation': 1.0})
    drives = [drive(simulator, seed, commands, frames=3) for seed in (7, 8, 7)]
    again = drive(make_simulator(profile, {'level': 2}), 7, commands, frames=3)
    assert drives[0] == drives[2] == again
    assert drives[0][0] != drives[1][0]


@installed
def test_it_can_be_made_after_another_simulator_has_closed_the_display():
    make_simulator('pyracerz_raw').close()
    pygame.display.quit()
    simulator = make_simulator('pyracerz_raw')
    assert np.ptp(simulator.reset(1).pixels) > 0
    simulator.close()


@installed
def test_frames_that_nobody_sees_change_nothing():
    simulator = make_simulator('pyracerz_carracing')
    commands = some_commands(40)
    seen = drive(simulator, 3, commands)[-1]
    simulator.reset(3)
    for command in commands[:-1]:
        assert simulator.advance(command, draw=False).pixels is None
    outcome = simulator.advance(commands[-1])
    assert (outcome.pixels.tobytes(), dict(outcome.info)) == (seen[0], seen[4])


@installed
@pytest.mark.parametrize('direction', ['normal', 'reverse'])
@pytest.mark.parametrize('track', ['bio', 'formula'])
def test_the_games_own_robot_ends_a_lap_and_is_paid_for_each_checkpoint(track, direction):
    simulator = make_simulator('pyracerz', {
        'track': track, 'direction': direction, 'driver': 'robot', 'start_variation': 0.0})
    simulator.reset(0)
    outcome = simulator.advance(Command(0.0, 0.0), 1250, draw=False)
    assert outcome.terminated and not outcome.truncated and outcome.info['lap_finished']
    # 1000 for the checkpoints of a lap, 0.1 off for each frame
    assert outcome.reward == pytest.approx(1000 - 0.1 * outcome.frames)
    # from rest, so the whole episode is the lap
    assert outcome.info['lap_seconds'] == pytest.approx(outcome.frames * 0.02, abs=0.02)


@installed
def test_left_is_left_and_the_nose_is_up():
    simulator = make_simulator('pyracerz', {'start_variation': 0.0})
    before = simulator.reset(0).info
    for steering in (1.0, -1.0):
        simulator.reset(0)
        after = simulator.advance(Command(1.0, steering), 10).info
        assert math.remainder(after['heading'] - before['heading'], 2 * math.pi) * steering > 0.1
    simulator.reset(0)
    after = simulator.advance(Command(1.0, 0.0), 50).info
    way = after['x'] - before['x'], before['y'] - after['y']
    assert math.atan2(way[1], way[0]) == pytest.approx(after['heading'], abs=0.01)


@installed
def test_an_episode_is_cut_off_at_its_last_frame():
    simulator = make_simulator('pyracerz', {'max_episode_frames': 5, 'steps_per_frame': 4})
    simulator.reset(1)
    outcome = simulator.advance(Command(0.0, 0.0), 9)
    assert (outcome.truncated, outcome.terminated, outcome.frames) == (True, False, 5)
    assert simulator.frame_seconds == pytest.approx(0.04)


@installed
def test_the_road_is_gray_and_the_rest_green_in_the_picture_for_policies_of_carracing():
    pixels = make_simulator('pyracerz_carracing', {'start_variation': 0.0}).reset(0).pixels
    assert (pixels[58, 48] == 104).all(), 'road before the car'
    assert pixels[72, 48, 0] > 195 > 10 > pixels[72, 48, 1], "the car, in CarRacing's red"
    assert not pixels[95, 40].any(), 'the panel'
    assert (pixels[:84] == (102, 204, 102)).all(axis=2).any()


@installed
@pytest.mark.parametrize(('settings', 'told'), [
    ({'track': 'monza'}, "track is 'monza'; accepted: bio, city, desert, formula, http, kart, "),
    ({'track': '../secret'}, "track is '../secret'; accepted: "),
])
def test_a_track_that_is_none_is_told_in_one_line(settings, told):
    with pytest.raises(SimulatorError, match=told) as caught:
        make_simulator('pyracerz', settings)
    assert '\n' not in str(caught.value)


def test_a_missing_game_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(pyracerz_game, 'FOLDER', tmp_path / 'none')
    pyracerz_game._modules.cache_clear()
    with pytest.raises(SimulatorError, match='apt-get install pyracerz') as caught:
        make_simulator('pyracerz')
    assert '\n' not in str(caught.value)


@installed
def test_the_modules_of_the_game_leave_their_names_to_others():
    pyracerz_game.load_game()
    assert not set(pyracerz_game.MODULES) & set(sys.modules)


@installed
def test_the_shipped_policy_drives_it_over_topics_and_its_bag_is_driven_again(tmp_path):
    run = tmp_path / 'run'
    ran = carracing('run', '--simulator', 'pyracerz_carracing', '--model', 'racing', '--laps', '1',
                    '--output', str(run), timeout=150)
    assert ran.returncode == 0, ran
    verified = carracing('bag', 'verify', str(run / 'bag'), '--simulator', 'pyracerz_carracing')
    assert verified.returncode == 0 and '0 differ' in verified.stdout, verified
