# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The tuner: shares of two action spaces, moved by what a series of episodes earned."""
import json

from carracing_dqn.studies.one_process import learn
from dqn_policy_node import Policy
from dqn_policy_node.action_space import action_space
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_record import MAX_MODEL_FILE_BYTES
from dqn_policy_node.network import QNetwork
from dqn_policy_node.weights_message import decode_weights, encode_weights
from learning_cases import tiny
from msgs_bridge.errors import SettingsError
from msgs_bridge.twists import Command
import numpy as np
import pytest
from trainer_node.training import Training
from trainer_node.tuner import MOST_SERIES, Tuner

SPACE = 'seed5+any'
COMMAND, ANYTHING = Command(1.0, 0.0), Command(0.5, 0.05)


def settings(**changes):
    return tiny(action_space=SPACE, **{'tuner_series': 4, **changes})


def episode(tuner, command, value, number=1):
    for _ in range(5):
        tuner.took(command)
    # a command of the table that the axes can drive, too, does not make it another episode
    tuner.took(COMMAND)
    return tuner.episode_ended(number, value)


def test_the_share_moves_to_what_earned_more():
    tuner = Tuner(settings())
    assert tuner.share == 0.5
    for command, value in ((COMMAND, 10.0), (ANYTHING, 30.0), (COMMAND, 20.0)):
        assert not episode(tuner, command, value)
    assert episode(tuner, ANYTHING, 0.0, 4)
    assert tuner.share == 0.5 and len(tuner.series) == 1  # 15 each
    for value in (1.0, 2.0, 3.0):
        episode(tuner, ANYTHING, value)
    assert episode(tuner, COMMAND, 1.0, 8)
    assert tuner.share == 0.6
    assert tuner.to_json()[1] == {'episodes': 8, 'share': 0.5, 'commands': 1.0, 'axes': 2.0}
    # nothing to compare with: it stays
    for _ in range(4):
        episode(tuner, ANYTHING, 100.0)
    assert tuner.share == 0.6 and tuner.series[-1].commands is None
    for _ in range(20):
        for command, value in ((COMMAND, 1.0), (ANYTHING, 0.0)) * 2:
            episode(tuner, command, value)
    assert tuner.share == 0.1
    # a run that is resumed with a larger least share
    later = Tuner(settings(tuner_least=0.3))
    later.restore(tuner.state())
    assert later.share == 0.3


def test_what_an_episode_that_was_cut_off_has_driven_is_not_of_the_next_one():
    tuner = Tuner(settings(tuner_series=1))
    for _ in range(50):
        tuner.took(COMMAND)
    for number in range(5):
        tuner.took(ANYTHING, goes_on=number > 0)
    assert tuner.episode_ended(1, 7.0)
    assert (tuner.series[0].commands, tuner.series[0].axes) == (None, 7.0)


def test_a_policy_drives_an_episode_with_one_of_the_two():
    own = settings().model_description()
    policy = Policy(own, seed=0)
    single = action_space(SPACE).single
    data = encode_weights(QNetwork(own).state_dict(), own, version=1, epsilon=0.5,
                          extra={'axes_share': 0.25})
    policy.swap_weights(decode_weights(data, own))
    frame = np.random.default_rng(0).integers(0, 256, (96, 96, 3), np.uint8)
    kinds = []
    for _ in range(200):
        policy.reset()
        answers = [policy.decide(frame) for _ in range(4)]
        kind = {single[own.action_space.mode(answer.action)] for answer in answers}
        assert len(kind) == 1
        kinds += kind
    assert 0.15 < np.mean([not kind for kind in kinds]) < 0.35
    # a validation chooses from everything
    policy.act_greedily()
    policy.reset()
    answer = policy.decide(frame)
    assert answer.command == own.action_space.decode(own.action_space.greedy(answer.q_values))


@pytest.mark.parametrize(('space', 'share'), [
    (SPACE, 1.5), (SPACE, 'x'), (SPACE, True), (SPACE, float('nan')), ('seed5', 0.5),
    ('continuous', 0.5)])
def test_a_share_that_cannot_be_is_refused(space, share):
    own = tiny(action_space=space).model_description()
    data = encode_weights(QNetwork(own).state_dict(), own, version=1, extra={'axes_share': share})
    with pytest.raises(ModelError, match='weights axes_share'):
        decode_weights(data, own)


def test_a_space_of_one_part_has_nothing_to_tune():
    for space in ('seed5', 'continuous', 'hybrid'):
        with pytest.raises(SettingsError, match=r'those that have: seed5\+any, grid9\+any'):
            tiny(action_space=space, tuner_series=10)


def test_a_run_writes_down_what_it_chose(tmp_path):
    run = Training.create(settings(
        simulator='toy_simulator:Toy', frame_height=32, frame_width=48, frame_seconds=0.05,
        shrink=4, tuner_series=3, run_episodes=14, validation_every_episodes=0,
        learning_starts=50), tmp_path / 'run', device='cpu')
    learn(run)
    series = json.loads((tmp_path / 'run' / 'run.json').read_text())['tuner']
    assert len(series) == 4 and series[0]['share'] == 0.5
    assert all(each['axes'] is not None or each['commands'] is not None for each in series)
    for before, after in zip(series, series[1:]):
        if None in (before['axes'], before['commands']):
            assert after['share'] == before['share']
        else:
            assert after['share'] == pytest.approx(
                before['share'] + 0.1 * np.sign(before['axes'] - before['commands']))
    model = json.loads((tmp_path / 'run' / 'final' / 'model.json').read_text())
    assert model['training']['run']['tuner'] == series


def test_the_series_of_a_very_long_run_leave_its_models_readable():
    """They are told in `model.json`, which is not read when it is too long."""
    tuner = Tuner(settings(tuner_series=1))
    for number in range(MOST_SERIES + 5):
        tuner.episode_ended(number, -123.456789012345 * number)
    assert [tuner.series[0].episodes, tuner.series[-1].episodes] == [5, MOST_SERIES + 4]
    assert len(json.dumps(tuner.to_json(), indent=1)) < MAX_MODEL_FILE_BYTES / 2
