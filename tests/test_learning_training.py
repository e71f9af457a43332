# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A whole run on a stream of made-up transitions: determinism, resume, rows, limits."""
import dataclasses
import json
import shutil

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_folder import load_model
from dqn_policy_node.weights_message import decode_weights
from learning_cases import (
    Clock, create, drive, make_step, make_transition, rows, stream, streams, tiny,
)
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command
import numpy as np
import pytest
import torch
from trainer_node import observation_blocks
from trainer_node.checkpoint_file import read_checkpoint
from trainer_node.errors import LearningError, RunError
from trainer_node.hyperparameters import settings_of_model
from trainer_node.training import Training
import yaml

RICH = {
    'dropout': 0.2, 'convolutions': '4@4/4 8@2/1', 'n_steps': 3, 'double': True, 'dueling': True,
    'weight_average': 0.9, 'flips': True, 'loss': 'huber', 'tile_missed_penalty': 1.0,
}


def without_clock(path):
    return [{k: v for k, v in row.items() if k not in ('wall_seconds', 'updates_per_second')}
            for row in rows(path)]


def test_the_same_stream_gives_the_same_weights(tmp_path):
    messages = ([], [])
    for name, log in zip('ab', messages):
        training = create(tmp_path / name, **RICH)
        drive(training, stream(150), log)
        training.finish()
    assert messages[0] == messages[1]
    assert without_clock(tmp_path / 'a' / 'episodes.csv') == without_clock(
        tmp_path / 'b' / 'episodes.csv')


CARS = ('/car_0', '/car_1', '/car_2')
TUNED = {'action_space': 'seed5+any', 'tuner_series': 2}


@pytest.mark.parametrize('stop, changes, names', [
    (5, {}, ()), (21, {}, ()), (140, {}, ()), (140, {'learner': 'qr_dqn', 'quantiles': 8}, ()),
    (140, {'action_space': 'continuous'}, ()), (140, TUNED, CARS),
    (140, {**TUNED, 'learner': 'qr_dqn', 'quantiles': 8}, ()),
    (21, {}, CARS), (140, {}, CARS), (140, {'replay_capacity': 100}, CARS)])
def test_an_interrupted_run_goes_on_as_if_nothing_had_happened(
        tmp_path, stop, changes, names, monkeypatch):
    # so that the observations of this short run fill blocks, too
    monkeypatch.setattr(observation_blocks, 'BLOCK', 16)
    transitions = list(streams(230, names) if names else stream(230))
    whole, parts = [], []
    training = create(tmp_path / 'whole', **RICH, **changes)
    drive(training, transitions, whole)
    training.finish()

    training = create(tmp_path / 'parts', **RICH, **changes)
    drive(training, transitions[:stop], parts)
    training.save()
    # what happens after the checkpoint is lost, and its rows with it
    lost = transitions[stop:stop + 40]
    drive(training, lost)
    # a checkpoint that was cut off may leave blocks of what is lost behind
    training._checkpoint._blocks.write(training.learning.replay)
    torch.manual_seed(99)
    training = Training.resume(tmp_path / 'parts', device='cpu', clock=Clock())
    drive(training, transitions[stop:], parts)
    training.finish()

    assert parts == whole
    first = read_checkpoint(tmp_path / 'whole' / 'checkpoint' / 'checkpoint.safetensors')
    second = read_checkpoint(tmp_path / 'parts' / 'checkpoint' / 'checkpoint.safetensors')
    assert first[0].keys() == second[0].keys()
    for name, array in first[0].items():
        assert np.array_equal(array, second[0][name]), name
    assert first[1]['learning'] == second[1]['learning']
    oldest = training.learning.replay.oldest
    # of a block that is overwritten in part, files may differ there
    blocks = [{block: sum_ for block, sum_ in state['blocks'].items() if 16 * int(block) >= oldest}
              for _, state in (first, second)]
    assert blocks[0] == blocks[1] != {}
    for name in ('episodes.csv', 'validation.csv', 'updates.csv', *['cars.csv'] * bool(names)):
        assert without_clock(tmp_path / 'whole' / name) == without_clock(
            tmp_path / 'parts' / name)
    assert (tmp_path / 'whole' / 'cars.csv').exists() == bool(names)
    record = json.loads((tmp_path / 'parts' / 'run.json').read_text())
    assert len(record['sessions']) == 2


def test_one_of_several_sources_that_cannot_be_used_does_not_end_the_others(tmp_path):
    training = create(tmp_path / 'run', tile_missed_penalty=1.0)
    odd = make_transition(step=make_step(decision=1), command=Command(0.3, 0.3))
    poor = make_transition()
    for step in (poor.step, poor.previous):
        del step.info['tiles_missed']
    for transition, error in ((odd, 'no action of'), (poor, "needs 'tiles_missed'")):
        with pytest.raises(MessageError, match=error):
            training.add(transition, '/odd')
    drive(training, streams(40, CARS))
    sources = training.learning.sources
    assert sources['/odd'].left_out == {'foreign_actions': 1, 'bad_steps': 1}
    assert sources['/odd'].decisions == 0 < training.learning.learner.updates
    assert sum(of.decisions for of in sources.values()) == training.decisions == 40
    assert sum(of.episodes for of in sources.values()) == training.episodes > 0
    of_cars = rows(tmp_path / 'run' / 'cars.csv')
    assert [int(row['run_episode']) for row in of_cars] == [*range(training.episodes)]
    for name in CARS:
        assert [int(row['episode']) for row in of_cars if row['source'] == name] == [
            *range(sources[name].episodes)]
    training.save()
    training.folder.cars.unlink()
    with pytest.raises(RunError, match='cars.csv: it is gone'):
        Training.resume(tmp_path / 'run', device='cpu')


def test_rows_have_the_columns_of_the_report_and_more(tmp_path):
    training = create(tmp_path / 'run', validation_every_episodes=2)
    drive(training, stream(13 * 5))
    training.finish()
    episodes = rows(tmp_path / 'run' / 'episodes.csv')
    assert [row['episode'] for row in episodes] == list('01234')
    assert list(episodes[0])[:5] == [
        'episode', 'train_reward', 'validation_reward', 'epsilon', 'learning_rate']
    asked = [row['mean'] for row in rows(tmp_path / 'run' / 'validation.csv')]
    assert [row['validation_reward'] for row in episodes] == ['', '', asked[0], '', asked[1]]
    assert episodes[0]['epsilon'] == '1'
    assert float(episodes[1]['epsilon']) == pytest.approx(0.995)
    assert episodes[4]['decisions'] == '65'
    assert episodes[4]['frames'] == '52'
    assert float(episodes[4]['replay_ratio']) == 8.0
    assert [row['episode'] for row in rows(tmp_path / 'run' / 'validation.csv')] == ['2', '4']


def test_updates_are_written_every_so_often(tmp_path, monkeypatch):
    monkeypatch.setattr('trainer_node.run_record.UPDATES_PER_ROW', 10)
    training = create(tmp_path / 'run')
    drive(training, stream(60))
    found = rows(tmp_path / 'run' / 'updates.csv')
    assert [row['updates'] for row in found] == ['10', '20', '30', '40']
    assert all(float(row['loss']) > 0 for row in found)


def test_validations_are_due_by_decisions_and_by_the_clock(tmp_path):
    for name, changes in (
        ('a', {'validation_every_decisions': 25}), ('b', {'validation_every_minutes': 1.0}),
    ):
        training = create(tmp_path / name, validation_every_episodes=0, **changes)
        asked = []
        for transition in stream(80):
            training.add(transition)
            if training.weights_due():
                update = decode_weights(training.next_weights())
                if update.validate:
                    asked.append(training.decisions)
        assert asked
        if name == 'a':
            assert asked == [25, 50, 75]


def test_a_stamp_that_does_not_follow_starts_a_new_segment(tmp_path):
    training = create(tmp_path / 'run')
    transitions = list(stream(12))
    del transitions[5]
    for transition in transitions:
        training.add(transition)
    # 11 transitions in two segments: an observation more than transitions for each
    assert len(training.learning.replay) == 13
    assert training.learning.replay.transitions == 11


def test_an_action_that_is_none_of_ours_is_left_out(tmp_path):
    training = create(tmp_path / 'run')
    transitions = list(stream(8))
    transitions[4] = dataclasses.replace(transitions[4], command=Command(0.0, 0.123))
    for index, transition in enumerate(transitions):
        if index == 4:
            with pytest.raises(MessageError, match='no action of'):
                training.add(transition)
        else:
            training.add(transition)
    assert training.status()['foreign_actions'] == 1
    assert training.learning.replay.transitions == 7
    assert len(training.learning.replay) == 9


def test_ends_are_kept_apart(tmp_path):
    for terminal in (False, True):
        training = create(tmp_path / f'run{terminal}', early_end_terminal=terminal)
        first = next(iter(stream(1)))
        step = make_step(truncated=1.0, ended_early=1.0)
        training.add(dataclasses.replace(first, step=step))
        batch = training.learning.replay.sample(4, np.random.default_rng(0))
        assert batch.discounts[0] == pytest.approx(0.0 if terminal else 0.99)
    training = create(tmp_path / 'run3')
    training.add(dataclasses.replace(first, step=make_step(terminated=1.0)))
    assert training.learning.replay.sample(1, np.random.default_rng(0)).discounts[0] == 0.0


def test_a_run_ends_at_its_nearest_limit(tmp_path):
    training = create(tmp_path / 'a', run_decisions=100, run_episodes=50)
    drive(training, stream(50))
    assert training.progress == pytest.approx(0.5)
    drive(training, stream(50, seed=1))
    assert training.complete
    timed = create(tmp_path / 'b', run_minutes=0.5)
    drive(timed, stream(60))
    assert timed.complete


def test_status_has_the_figures_of_the_moment(tmp_path):
    training = create(tmp_path / 'run')
    drive(training, stream(45))
    status = training.status()
    assert (status['episodes'], status['decisions'], status['updates']) == (3, 45, 25)
    assert {'epsilon', 'learning_rate', 'replay_ratio', 'weights_version', 'last_return',
            'mean_return', 'validation_mean', 'best_validation'} <= status.keys()
    assert all(isinstance(value, (int, float)) for value in status.values())


def test_what_cannot_change_in_a_run_is_refused_with_what_differs(tmp_path):
    training = create(tmp_path / 'run')
    drive(training, stream(30))
    training.save()
    for changes, text in (
        ({'hidden': 16}, 'network.hidden is 16, not 8'),
        ({'action_space': 'grid9'}, 'action_space'),
        ({'replay_capacity': 300}, 'replay_capacity is 300, not 200'),
        ({'weight_average': 0.9}, 'weight_average is 0.9, not 0.0'),
        ({'learner': 'qr_dqn'}, 'learner is qr_dqn, not dqn'),
        # rewards that are made otherwise must not be mixed with those in the replay buffer
        ({'reward_scale': 0.5}, 'reward_scale is 0.5, not 1.0'),
        ({'finish_bonus': 25.0}, 'finish_bonus is 25.0, not 0.0'),
        ({'standing_growth': 1.1}, 'standing_growth is 1.1, not 1.02'),
        ({'early_end_terminal': True}, 'early_end_terminal is True, not False'),
    ):
        with pytest.raises(RunError, match=text) as caught:
            Training.resume(tmp_path / 'run', tiny(**changes), device='cpu')
        assert '\n' not in str(caught.value)
    later = Training.resume(tmp_path / 'run', tiny(gamma=0.9), device='cpu')
    assert later.settings.gamma == 0.9
    assert yaml.safe_load((tmp_path / 'run' / 'config.yaml').read_text())['gamma'] == 0.9


@pytest.mark.parametrize('schedule', ['constant', 'plateau', 'linear'])
def test_another_learning_rate_is_learned_with_from_then_on(tmp_path, schedule):
    own = {'learning_rate_schedule': schedule, 'run_decisions': 10_000}
    training = create(tmp_path / 'run', learning_rate=1e-3, **own)
    drive(training, stream(60))
    training.save()
    later = Training.resume(
        tmp_path / 'run', tiny(learning_rate=1e-5, **own), device='cpu')
    drive(later, stream(60, seed=1))
    assert later.learning.learning_rate == pytest.approx(1e-5, rel=0.02)
    group, = later.learning.learner._optimizer.param_groups
    assert group['lr'] == later.learning.learning_rate


@pytest.mark.parametrize('changes, updates', [
    ({'samples_per_transition': 16.0}, 40), ({'batch_size': 16}, 10), ({'batch_size': 4}, 40)])
def test_another_ratio_counts_from_then_on(tmp_path, changes, updates):
    training = create(tmp_path / 'run')
    drive(training, stream(150))
    training.save()
    later = Training.resume(tmp_path / 'run', tiny(**changes), device='cpu')
    made = [later.add(transition) for transition in stream(20, seed=1)]
    assert sum(made) == updates
    assert max(made) <= 2


def test_the_epsilon_of_a_row_is_the_one_that_was_driven_with(tmp_path):
    by_decisions = {'epsilon_schedule': 'decisions', 'epsilon_decisions': 100,
                    'weights_every': 1000}
    training = create(tmp_path / 'run', **by_decisions, validation_every_episodes=0)
    drive(training, stream(26))
    # the weights went out after the first transition and never again
    assert [float(row['epsilon']) for row in rows(training.folder.episodes)] == (
        pytest.approx([0.9901, 0.9901]))
    training = create(tmp_path / 'by_episodes', weights_every=1000)
    acting = []
    for transition in stream(13 * 4):
        if training.weights_due():
            acting.append(decode_weights(training.next_weights()).epsilon)
        training.add(transition)
    # each episode was begun with its own
    assert acting == pytest.approx(list(0.995 ** np.arange(4)))
    assert [float(row['epsilon']) for row in rows(training.folder.episodes)] == (
        pytest.approx(acting, rel=1e-5))


@pytest.mark.parametrize('changes', [{}, {'learner': 'qr_dqn', 'quantiles': 8}])
def test_a_run_begins_with_the_weights_of_a_model_and_takes_its_settings(tmp_path, changes):
    first = create(tmp_path / 'first', **RICH, **changes)
    drive(first, stream(150))
    model = load_model(first.finish())
    settings = settings_of_model(model.description, first.settings.frame_seconds)
    assert tiny(**settings).model_description() == model.description
    # seen from the run folder
    second = create(tmp_path / 'second', **{**settings, 'initial_model': '../first/final'})
    for name, tensor in second.learning.learner.acting_tensors().items():
        assert torch.equal(tensor, model.tensors[name])
    for name, tensor in second.learning.learner.target.state_dict().items():
        assert torch.equal(tensor, model.tensors[name])
    drive(second, stream(60))
    second.finish()
    # and it goes on without the model
    shutil.rmtree(tmp_path / 'first')
    assert Training.resume(tmp_path / 'second').decisions == second.decisions


def test_a_model_that_is_missing_or_does_not_fit_begins_no_run(tmp_path):
    first = create(tmp_path / 'first', **RICH)
    first.finish()
    with pytest.raises(LearningError, match='initial_model does not fit.*network.hidden'):
        create(tmp_path / 'second', **{
            **RICH, 'hidden': 2 * first.settings.hidden, 'initial_model': '../first/final'})
    with pytest.raises(ModelError, match="no model '../nowhere'"):
        create(tmp_path / 'third', initial_model='../nowhere')


def test_runs_that_are_not_there_or_in_the_way_are_named(tmp_path):
    with pytest.raises(RunError, match='no such checkpoint'):
        Training.resume(tmp_path / 'nothing')
    create(tmp_path / 'run')
    with pytest.raises(RunError, match='holds a run already'):
        create(tmp_path / 'run')
    (tmp_path / 'file').write_text('')
    with pytest.raises(RunError, match='file'):
        create(tmp_path / 'file' / 'run')


def test_a_reward_that_is_not_finite_is_left_out(tmp_path):
    training = create(tmp_path / 'run')
    for index, transition in enumerate(stream(60)):
        if index == 30:
            step = dataclasses.replace(transition.step, reward=float('nan'))
            with pytest.raises(MessageError, match='reward is nan'):
                training.add(dataclasses.replace(transition, step=step))
        else:
            training.add(transition)
    assert training.status()['bad_steps'] == 1
    assert training.learning.learner.updates > 30


def test_learning_that_fails_keeps_the_checkpoint_of_before(tmp_path):
    training = create(tmp_path / 'run')
    transitions = list(stream(80))
    drive(training, transitions[:40])
    kept = training.save().read_bytes()
    with torch.no_grad():
        training.learning.learner.online.hidden.weight[0, 0] = float('nan')
    with pytest.raises(LearningError, match='the loss is nan.*online weights .hidden.weight'):
        drive(training, transitions[40:])
    for end in (training.save, training.finish):
        with pytest.raises(RunError, match='learning has failed, so the checkpoint before'):
            end()
    assert training.folder.checkpoint.read_bytes() == kept
    later = Training.resume(tmp_path / 'run', device='cpu')
    drive(later, transitions[40:])
    assert later.decisions == 80


def test_no_file_of_a_run_is_a_pickle(tmp_path):
    training = create(tmp_path / 'run')
    drive(training, stream(60))
    training.finish()
    training.finish()
    names = {path.suffix for path in (tmp_path / 'run').rglob('*') if path.is_file()}
    assert names == {'.csv', '.json', '.safetensors', '.yaml'}
    assert load_model(tmp_path / 'run' / 'final').training['decisions'] == 60


def test_event_files_on_request(tmp_path):
    pytest.importorskip('tensorboard')
    training = Training.create(tiny(), tmp_path / 'run', device='cpu', tensorboard=True)
    drive(training, stream(60))
    training.finish()
    assert list((tmp_path / 'run' / 'tensorboard').glob('events.out.tfevents.*'))


@pytest.mark.parametrize('names', [[''], ['/a', '/b']])
def test_an_episode_whose_last_transition_is_left_out_has_ended_all_the_same(tmp_path, names):
    """Whoever drives it home may do so by a command that is none of the actions."""
    training = create(tmp_path / 'run', run_episodes=4, epsilon_schedule='episodes',
                      validation_every_episodes=4)
    epsilon = training.learning.epsilon
    left_out = 0
    for name in names:
        for transition in stream(13 * 4 // len(names)):
            ended = transition.step.ended
            assert not training.complete
            try:
                training.add(dataclasses.replace(transition, command=Command(
                    0.5, 0.123)) if ended else transition, name)
            except MessageError:
                left_out += ended
    assert left_out == training.episodes == 4 and training.complete
    assert training.learning.epsilon < epsilon
    assert [row['train_reward'] != '' for row in rows(training.folder.episodes)] == [True] * 4
    assert decode_weights(training.next_weights()).validate


def test_a_simulator_that_uses_its_stamps_again_does_not_go_on_where_it_was(tmp_path):
    """Frame and stamp must fit; of a run that goes on, what its checkpoint has seen of it."""
    training = create(tmp_path / 'run')
    first, second = stream(2)
    other = dataclasses.replace(
        next(stream(1, seed=9)), stamp=second.stamp, next_stamp=second.next_stamp)
    training.add(first)
    training.save()
    for transition, goes_on in ((second, True), (other, False)):
        resumed = Training.resume(tmp_path / 'run', device='cpu')
        assert resumed.learning.insert(transition) is goes_on
        again = create(tmp_path / f'run{goes_on}')
        again.add(first)
        assert again.learning.insert(transition) is goes_on
        assert len(again.learning.replay) == (3 if goes_on else 4)
