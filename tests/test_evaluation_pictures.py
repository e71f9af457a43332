# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Laps seen from above."""
import dataclasses

from carracing_dqn.bringup.command import main as carracing
from carracing_dqn.evaluation.lap_picture import draw_lap, lap_end, lap_picture
from carracing_dqn.evaluation.laps import drive_lap
from carracing_dqn.evaluation.trajectory import drive_trajectory, RecordedActions
from carracing_dqn.simulation import make_simulator
from evaluation_cases import ByPixels, lap, Steady
from msgs_bridge.twists import Command, STOP
import numpy as np
from PIL import Image
import pytest


def fast(frames):
    return make_simulator('fast', {'max_episode_frames': frames})


def test_a_trajectory_is_the_lap_it_drew():
    trajectory = drive_trajectory(fast(150), Steady((0.0, 1.0, 0.0)), 6)
    assert trajectory.lap == drive_lap(fast(150), Steady((0, 1, 0)), 6)
    assert trajectory.position.shape == (150, 2)
    assert trajectory.reward.sum() == pytest.approx(trajectory.lap.episode_return, abs=1e-5)
    assert trajectory.visited.sum() == trajectory.lap.tiles_visited
    assert len(trajectory.left_edge) == len(trajectory.right_edge) == trajectory.lap.tiles_total
    # straight on at full gas, the car leaves the road in the first bend
    first, last = trajectory.off_road[0]
    assert trajectory.wheels_off[:first].max() < 4
    assert trajectory.wheels_off[first:last + 1].min() == 4
    # what it passes in a frame is what its speed says
    steps = np.linalg.norm(np.diff(trajectory.position, axis=0), axis=1) * 50
    assert steps == pytest.approx(trajectory.speed[1:], rel=0.05, abs=0.5)


def test_the_road_lies_under_the_car_at_the_start():
    trajectory = drive_trajectory(fast(1), Steady((0, 0, 0)), 6)
    middle = (trajectory.left_edge[0] + trajectory.right_edge[0]) / 2
    assert np.linalg.norm(trajectory.position[0] - middle) < 1
    # the road is 2 * 40 / 6 wide
    width = np.linalg.norm(trajectory.left_edge - trajectory.right_edge, axis=1)
    assert width == pytest.approx(80 / 6)


def test_off_road_stretches_and_reward_rate():
    trajectory = drive_trajectory(fast(8), Steady(), 6)
    changed = dataclasses.replace(
        trajectory, wheels_off=np.array([0, 4, 4, 3, 4, 0, 2, 4]), reward=np.full(8, -0.1))
    assert changed.off_road == [(1, 2), (4, 4), (7, 7)]
    assert changed.reward_rate == pytest.approx(np.full(8, -5.0))


def test_recorded_actions_drive_the_same_lap():
    policy = ByPixels()
    actions = []

    class Remembering:
        def reset(self, seed=None):
            policy.reset(seed)

        def act(self, frame):
            actions.append(policy.act(frame))
            return actions[-1]

    driven = drive_lap(fast(100), Remembering(), 9)
    assert drive_lap(fast(100), RecordedActions(actions), 9) == driven
    assert RecordedActions([Command(1.0, 0.0)]).act(None) == (1.0, 0.0)
    assert RecordedActions([]).act(None) == STOP


@pytest.mark.parametrize('phone', [False, True])
def test_a_lap_that_stopped_is_marked(phone):
    trajectory = drive_trajectory(fast(130), Steady((0, 0, 1)), 6)
    assert trajectory.lap.standing_still > 100
    figure = lap_picture(trajectory, phone=phone)
    words = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert words == ['start', 'end', 'stopped', 'tile not visited']


def test_a_picture_is_written(tmp_path):
    env_lap = draw_lap(Steady((0.0, 1.0, 0.0)), 6, tmp_path / 'lap.png')
    assert env_lap.left_field
    with Image.open(tmp_path / 'lap.png') as picture:
        assert picture.size[0] > 1000


def test_the_command_draws_every_lap(tmp_path):
    assert carracing([
        'evaluate', '--policy', 'random', '--episodes', '2', '--seed', '3', '--simulator', 'fast',
        '--processes', '1', '--pictures', str(tmp_path / 'laps')]) == 0
    assert {path.name for path in (tmp_path / 'laps').iterdir()} == {'lap_3.png', 'lap_4.png'}


def test_ends_in_words():
    assert lap_end(lap(1, 900, frames=700, lap_finished=True)) == 'lap finished in 14.0 s'
    assert lap_end(lap(1, 0, frames=100, left_field=True)) == 'left the field after 2.0 s'
    assert lap_end(lap(1, 0, standing_still=150)) == 'stood still for the last 3.0 s'
    assert lap_end(lap(1, 0)) == 'not finished in 20.0 s'
