# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What stands between picture and policy in `carracing bench robustness` is what it says."""
from carracing_dqn.benchmarks.bench_robustness import Condition, CONDITIONS, Disturbed, main
from carracing_dqn.evaluation.laps import drive_lap
from carracing_dqn.evaluation.policies import model_source
from carracing_dqn.simulation import make_simulator
from dqn_policy_node.policy import Answer
from msgs_bridge.twists import Command, STOP
import numpy as np
import pytest

FRAMES = 1000


class Witness:
    """Notes what it sees and when; decides at every frame it is given."""

    action_seconds = 0.0

    def __init__(self):
        self.seen, self.elapsed = [], []

    def reset(self, seed=None):
        self.seen.clear()

    def decide(self, frame, elapsed=None):
        self.seen.append(frame)
        self.elapsed.append(elapsed)
        return Answer(0, Command(0.001 * frame.flat[0], 0.0), None, False)


def shown(condition, frames=FRAMES):
    """Return what a witness saw of frames that are all of their number, and the answers."""
    witness = Witness()
    disturbed = Disturbed(witness, condition, 0.02)
    answers = [disturbed.act(np.full((4, 4, 3), number % 250, np.uint8))
               for number in range(frames)]
    return witness, answers


def test_without_a_condition_every_frame_is_seen_at_once():
    witness, _ = shown(Condition())
    assert [frame.flat[0] for frame in witness.seen] == [n % 250 for n in range(FRAMES)]


@pytest.mark.parametrize('late', [1, 2, 4])
def test_late_pictures_are_those_of_before(late):
    witness, answers = shown(Condition(late=late))
    assert answers[:late] == [STOP] * late
    assert len(witness.seen) == FRAMES - late
    assert [frame.flat[0] for frame in witness.seen[:5]] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize('rate', [30.0, 15.0])
def test_a_slow_camera_gives_so_many_pictures(rate):
    witness, _ = shown(Condition(rate=rate))
    assert len(witness.seen) == pytest.approx(rate * FRAMES * 0.02, abs=1)
    assert min(witness.elapsed[1:]) >= 20_000_000


def test_lost_pictures_leave_the_command_as_it_was():
    witness, answers = shown(Condition(lost=0.2))
    assert 0.7 < len(witness.seen) / FRAMES < 0.9
    assert sum(one == before for one, before in zip(answers[1:], answers)) == pytest.approx(
        FRAMES - len(witness.seen), abs=2)


def test_noise_brightness_and_blur_change_what_is_seen():
    grey = np.full((8, 8, 3), 100, np.uint8)
    assert np.std(Disturbed(Witness(), Condition(noise=10.0), 0.02)._seen(grey)) > 5
    gains = {int(made._seen(grey).flat[0]) for made in _laps(Condition(brightness=0.3), 20)}
    assert len(gains) > 5 and all(70 <= gain <= 130 for gain in gains)
    dot = np.zeros((8, 8, 3), np.uint8)
    dot[4, 4] = 90
    blurred = Disturbed(Witness(), Condition(blur=3), 0.02)._seen(dot)
    assert blurred.shape == dot.shape and set(np.unique(blurred)) == {0, 10}


def _laps(condition, count):
    made = Disturbed(Witness(), condition, 0.02)
    for seed in range(count):
        made.reset(seed)
        yield made


def test_as_it_is_is_the_lap_that_is_evaluated():
    simulator = make_simulator('fast', {'max_episode_frames': 60})
    source = model_source('racing')
    alone = drive_lap(simulator, source.open(0.02), 100_000)
    assert drive_lap(
        simulator, Disturbed(source.open(0.02), CONDITIONS['as it is'], 0.02), 100_000) == alone


def test_it_is_a_command(capsys, tmp_path):
    assert main(['--laps', '1', '--only', '4 frames late (80 ms)', '--json',
                 str(tmp_path / 'r.json')]) == 0
    assert '4 frames late' in capsys.readouterr().out and (tmp_path / 'r.json').is_file()
