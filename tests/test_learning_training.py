# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A whole run on a stream of made-up transitions: determinism, resume, files, trouble."""
import csv
import dataclasses
import errno
import json

from dqn_policy_node.model_folder import load_model
from dqn_policy_node.weights_message import decode_weights
from learning_cases import make_step, stream, tiny
from msgs_bridge import atomic_write
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command
import numpy as np
import pytest
import torch
from trainer_node import observation_blocks
from trainer_node.checkpoint_file import read_checkpoint
from trainer_node.errors import LearningError, RunError
from trainer_node.training import Training
import yaml

RICH = {
    'dropout': 0.2, 'convolutions': '4@4/4 8@2/1', 'n_steps': 3, 'double': True, 'dueling': True,
    'weight_average': 0.9, 'flips': True, 'loss': 'huber', 'tile_missed_penalty': 1.0,
}


class Clock:
    """Seconds that go forward by one with every look."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        self.seconds += 1.0
        return self.seconds


def drive(training, transitions, log=None):
    """Do what the node does with each transition."""
    for transition in transitions:
        training.add(transition)
        if training.weights_due():
            data = training.weights_message()
            if log is not None:
                log.append(data)
            update = decode_weights(data, training.description)
            if update.validate:
                training.record_validation(validation(update.version))


def validation(version, **changes):
    return {'version': version, 'episodes': 5, 'mean': 10.0 * version, 'std': 1.0, 'minimum': 0,
            'maximum': 20, 'completed': 0.2, 'seconds': 3, **changes}


def rows(path):
    with open(path, newline='') as file:
        return list(csv.DictReader(file))


def without_clock(path):
    return [{k: v for k, v in row.items() if k not in ('wall_seconds', 'updates_per_second')}
            for row in rows(path)]


def create(folder, **changes):
    return Training.create(tiny(**changes), folder, device='cpu', clock=Clock())


def test_the_same_stream_gives_the_same_weights(tmp_path):
    messages = ([], [])
    for name, log in zip('ab', messages):
        training = create(tmp_path / name, **RICH)
        drive(training, stream(150), log)
        training.finish()
    assert messages[0] == messages[1]
    assert without_clock(tmp_path / 'a' / 'episodes.csv') == without_clock(
        tmp_path / 'b' / 'episodes.csv')


@pytest.mark.parametrize('stop', [5, 21, 140])
def test_an_interrupted_run_goes_on_as_if_nothing_had_happened(tmp_path, stop, monkeypatch):
    # so that the observations of this short run fill blocks, too
    monkeypatch.setattr(observation_blocks, 'BLOCK', 16)
    transitions = list(stream(230))
    whole, parts = [], []
    training = create(tmp_path / 'whole', **RICH)
    drive(training, transitions, whole)
    training.finish()

    training = create(tmp_path / 'parts', **RICH)
    drive(training, transitions[:stop], parts)
    training.save()
    # what happens after the checkpoint is lost, and its rows with it
    lost = transitions[stop:stop + 40]
    drive(training, lost)
    # a checkpoint that was cut off may leave blocks of what is lost behind
    training._blocks.write(training.buffer)
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
    for name in ('random', 'learner_random', 'limiter', 'returns', 'learning_rate', 'written'):
        assert first[1][name] == second[1][name]
    for name in ('episodes.csv', 'validation.csv', 'updates.csv'):
        assert without_clock(tmp_path / 'whole' / name) == without_clock(
            tmp_path / 'parts' / name)
    record = json.loads((tmp_path / 'parts' / 'run.json').read_text())
    assert len(record['sessions']) == 2


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
    monkeypatch.setattr('trainer_node.training.UPDATES_PER_ROW', 10)
    training = create(tmp_path / 'run')
    drive(training, stream(60))
    found = rows(tmp_path / 'run' / 'updates.csv')
    assert [row['updates'] for row in found] == ['10', '20', '30', '40']
    assert all(float(row['loss']) > 0 for row in found)


def test_the_best_model_is_the_best_validated_one(tmp_path):
    training = create(tmp_path / 'run', validation_every_episodes=0)
    messages = {}
    for count, mean in ((1, 5.0), (2, 9.0), (3, 7.0)):
        messages[count] = decode_weights(training.weights_message(validate=True))
        drive(training, stream(40, seed=count))
        kept = training.record_validation(validation(messages[count].version, mean=mean))
        assert kept is (count != 3)
    model = load_model(tmp_path / 'run' / 'best')
    assert model.version == messages[2].version
    assert all(
        torch.equal(tensor, messages[2].tensors[name]) for name, tensor in model.tensors.items())
    assert model.training['best_validation']['mean'] == 9.0


def test_results_that_nobody_asked_for_are_left_out(tmp_path):
    training = create(tmp_path / 'run')
    training.weights_message()
    assert training.record_validation(validation(1)) is False
    assert rows(tmp_path / 'run' / 'validation.csv') == []
    with pytest.raises(MessageError, match="validation lacks 'episodes'"):
        training.record_validation({'version': 1})
    with pytest.raises(MessageError, match='not finite'):
        training.record_validation(validation(1, mean=float('nan')))


def test_a_spread_weight_prefers_the_steady_model(tmp_path):
    training = create(tmp_path / 'run', validation_spread_weight=0.5)
    for mean, std, kept in ((100.0, 60.0, True), (90.0, 10.0, True), (110.0, 80.0, False)):
        training.weights_message(validate=True)
        assert training.record_validation(
            validation(training.version, mean=mean, std=std)) is kept


def test_validations_are_due_by_decisions_and_by_the_clock(tmp_path):
    for name, changes in (
        ('a', {'validation_every_decisions': 25}), ('b', {'validation_every_minutes': 1.0}),
    ):
        training = create(tmp_path / name, validation_every_episodes=0, **changes)
        asked = []
        for transition in stream(80):
            training.add(transition)
            if training.weights_due():
                update = decode_weights(training.weights_message())
                if update.validate:
                    asked.append(training.decisions)
        assert asked
        if name == 'a':
            assert asked == [25, 50, 75]


def test_a_stamp_that_does_not_follow_starts_a_new_stretch(tmp_path):
    training = create(tmp_path / 'run')
    transitions = list(stream(12))
    del transitions[5]
    for transition in transitions:
        training.add(transition)
    # 11 transitions in two stretches: an observation more than transitions for each
    assert len(training.buffer) == 13
    assert training.buffer.transitions == 11


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
    assert training.buffer.transitions == 7
    assert len(training.buffer) == 9


def test_ends_are_kept_apart(tmp_path):
    for terminal in (False, True):
        training = create(tmp_path / f'run{terminal}', early_end_terminal=terminal)
        first = next(iter(stream(1)))
        step = make_step(truncated=1.0, ended_early=1.0)
        training.add(dataclasses.replace(first, step=step))
        batch = training.buffer.sample(4, np.random.default_rng(0))
        assert batch.discounts[0] == pytest.approx(0.0 if terminal else 0.99)
    training = create(tmp_path / 'run3')
    training.add(dataclasses.replace(first, step=make_step(terminated=1.0)))
    assert training.buffer.sample(1, np.random.default_rng(0)).discounts[0] == 0.0


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


def test_a_full_disk_keeps_the_checkpoint_before(tmp_path, monkeypatch):
    training = create(tmp_path / 'run')
    drive(training, stream(30))
    training.save()
    before = training.folder.checkpoint.read_bytes()
    drive(training, stream(30, seed=1))

    def full(handle):
        raise OSError(errno.ENOSPC, 'No space left on device')
    monkeypatch.setattr(atomic_write.os, 'fsync', full)
    with pytest.raises(OSError, match='No space left'):
        training.save()
    monkeypatch.undo()
    assert training.folder.checkpoint.read_bytes() == before
    assert [path.name for path in training.folder.checkpoint.parent.iterdir()] == [
        'checkpoint.safetensors']
    assert Training.resume(tmp_path / 'run', device='cpu').decisions == 30


@pytest.mark.parametrize('how', ['cut', 'empty', 'other', 'missing'])
def test_a_damaged_block_of_observations_is_named(tmp_path, how, monkeypatch):
    monkeypatch.setattr(observation_blocks, 'BLOCK', 16)
    training = create(tmp_path / 'run')
    drive(training, stream(60))
    training.save()
    block = sorted(training.folder.checkpoint.parent.glob('observations-*'))[1]
    block.unlink() if how == 'missing' else damage(block, how)
    with pytest.raises(RunError, match=f'{block.name}: damaged checkpoint'):
        Training.resume(tmp_path / 'run', device='cpu')


def test_blocks_that_no_checkpoint_needs_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(observation_blocks, 'BLOCK', 16)
    training = create(tmp_path / 'run')
    for seed in range(6):
        drive(training, stream(60, seed=seed))
        training.save()
    blocks = list(training.folder.checkpoint.parent.glob('observations-*'))
    assert training.buffer.oldest > 100
    assert len(blocks) <= training.settings.replay_capacity // 16 + 1


def test_another_network_is_refused_with_what_differs(tmp_path):
    training = create(tmp_path / 'run')
    drive(training, stream(30))
    training.save()
    for changes, text in (
        ({'hidden': 16}, 'network.hidden is 16, not 8'),
        ({'action_space': 'grid9'}, 'action_space'),
        ({'replay_capacity': 300}, 'replay_capacity is 300, not 200'),
        ({'weight_average': 0.9}, 'weight_average is 0.9, not 0.0'),
    ):
        with pytest.raises(RunError, match=text):
            Training.resume(tmp_path / 'run', tiny(**changes), device='cpu')
    later = Training.resume(tmp_path / 'run', tiny(gamma=0.9), device='cpu')
    assert later.settings.gamma == 0.9
    assert yaml.safe_load((tmp_path / 'run' / 'config.yaml').read_text())['gamma'] == 0.9


def damage(path, how):
    data = path.read_bytes()
    path.write_bytes({'cut': data[:len(data) // 2], 'empty': b'', 'other': b'\0' * 500}[how])


@pytest.mark.parametrize('how', ['cut', 'empty', 'other'])
def test_a_damaged_checkpoint_is_named_in_one_line(tmp_path, how):
    training = create(tmp_path / 'run')
    training.save()
    damage(training.folder.checkpoint, how)
    with pytest.raises(RunError, match='checkpoint.safetensors: damaged') as caught:
        Training.resume(tmp_path / 'run', device='cpu')
    assert '\n' not in str(caught.value)


def test_runs_that_are_not_there_or_in_the_way_are_named(tmp_path):
    with pytest.raises(RunError, match='no such checkpoint'):
        Training.resume(tmp_path / 'nothing')
    create(tmp_path / 'run')
    with pytest.raises(RunError, match='holds a run already'):
        create(tmp_path / 'run')
    (tmp_path / 'file').write_text('')
    with pytest.raises(RunError, match='file'):
        create(tmp_path / 'file' / 'run')


def test_csv_files_that_were_cut_by_hand_are_noticed(tmp_path):
    training = create(tmp_path / 'run')
    drive(training, stream(30))
    training.save()
    (tmp_path / 'run' / 'episodes.csv').write_text('')
    with pytest.raises(RunError, match='episodes.csv: .* bytes, but'):
        Training.resume(tmp_path / 'run', device='cpu')


def test_nan_stops_learning_and_the_state_can_still_be_saved(tmp_path):
    training = create(tmp_path / 'run')
    with pytest.raises(LearningError, match='update .*: the loss is nan'):
        for index, transition in enumerate(stream(200)):
            if index > 30:
                step = dataclasses.replace(transition.step, reward=float('nan'))
                transition = dataclasses.replace(transition, step=step)
            training.add(transition)
    assert training.save().is_file()


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
