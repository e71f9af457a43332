# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Which weights are the best, and what is known of them."""
import shutil

from dqn_policy_node.model_folder import load_model
from dqn_policy_node.weights_message import decode_weights
from learning_cases import create, drive, rows, stream, tiny, validation
from msgs_bridge.errors import MessageError
import pytest
import torch
from trainer_node.training import Training


def test_the_best_model_is_the_best_validated_one(tmp_path):
    training = create(tmp_path / 'run', validation_every_episodes=0)
    messages = {}
    for count, mean in ((1, 5.0), (2, 9.0), (3, 7.0)):
        messages[count] = decode_weights(training.next_weights(validate=True))
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
    training.next_weights()
    assert training.record_validation(validation(1)) is False
    assert rows(tmp_path / 'run' / 'validation.csv') == []
    with pytest.raises(MessageError, match="validation lacks 'episodes'"):
        training.record_validation({'version': 1})
    with pytest.raises(MessageError, match='not finite'):
        training.record_validation(validation(1, mean=float('nan')))


def test_a_spread_weight_prefers_the_steady_model(tmp_path):
    training = create(tmp_path / 'run', validation_spread_weight=0.5)
    for mean, std, kept in ((100.0, 60.0, True), (90.0, 10.0, True), (110.0, 80.0, False)):
        training.next_weights(validate=True)
        assert training.record_validation(
            validation(training.version, mean=mean, std=std)) is kept
    training.save()
    # another weight judges what was the best, too: 90 - 2 * 10 against 80 - 2 * 1
    later = Training.resume(
        tmp_path / 'run', tiny(validation_spread_weight=2.0), device='cpu')
    later.next_weights(validate=True)
    assert later.record_validation(validation(later.version, mean=80.0, std=1.0))
    later.next_weights(validate=True)
    with pytest.raises(MessageError, match='std of a validation is 1.7e'):
        later.record_validation(validation(later.version, std=1.7e308))


def test_the_best_of_a_session_that_was_killed_is_not_replaced_by_a_worse(tmp_path):
    training = create(tmp_path / 'run')
    for mean in (5.0, 8.0):
        training.save()
        training.next_weights(validate=True)
        training.record_validation(validation(training.version, mean=mean))
    # killed before it has saved that 8 is the best
    later = Training.resume(tmp_path / 'run', device='cpu')
    for mean, kept in ((6.0, False), (9.0, True)):
        later.next_weights(validate=True)
        assert later.record_validation(validation(later.version, mean=mean)) is kept


def test_a_result_that_comes_late_tells_of_when_its_weights_were_made(tmp_path):
    training = create(tmp_path / 'run', validation_every_episodes=0)
    drive(training, stream(40))
    training.next_weights(validate=True)
    version, then = training.version, training.moment
    drive(training, stream(60, seed=1))
    assert training.moment.decisions == 100
    training.record_validation(validation(version))
    row, = rows(training.folder.validation)
    assert (row['version'], row['decisions'], row['updates'], row['episode']) == tuple(
        map(str, (version, 40, then.updates, then.episode)))
    record = load_model(training.folder.best).training
    assert (record['decisions'], record['updates'], record['episodes']) == (
        40, then.updates, then.episode)
    assert record['wall_seconds'] == pytest.approx(then.wall_seconds, abs=2)
    assert record['best_validation']['decisions'] == 40


@pytest.mark.parametrize('changes', [
    {'mean': 1e300}, {'std': -1.0}, {'std': 1e308}, {'completed': 1.5}, {'episodes': 0},
    {'version': 1.5}, {'minimum': -1e10}])
def test_a_result_that_cannot_be_is_refused_and_the_true_one_is_still_taken(tmp_path, changes):
    """Anybody may publish one: it must not stand for ever as the best, or as the last."""
    training = create(tmp_path / 'run', validation_spread_weight=10.0)
    training.next_weights(validate=True)
    try:
        assert training.record_validation({**validation(1), **changes}) is False
        assert changes == {'version': 1.5}
    except MessageError as error:
        assert f'{next(iter(changes))} of a validation is' in str(error)
    assert 'best_validation' not in training.status() and not training.folder.best.exists()
    assert training.record_validation(validation(1, mean=5.0))
    assert training.status()['best_validation'] == training.status()['validation_mean'] == 5.0


def test_the_best_is_what_lies_in_its_folder_whatever_became_of_that(tmp_path):
    training = create(tmp_path / 'run')
    for mean in (5.0, 8.0):
        training.next_weights(validate=True)
        training.record_validation(validation(training.version, mean=mean))
        if mean == 5.0:
            shutil.copytree(training.folder.best, tmp_path / 'worse')
    training.save()

    def validated(mean):
        later = Training.resume(tmp_path / 'run', device='cpu')
        later.next_weights(validate=True)
        kept = later.record_validation(validation(later.version, mean=mean))
        later.save()
        return kept

    # the disk was full when the better one was to be written
    shutil.rmtree(training.folder.best)
    shutil.copytree(tmp_path / 'worse', training.folder.best)
    assert not validated(4.0)
    assert validated(6.0)
    # somebody has removed it: the next one is the best that there is, and one can wait for it
    shutil.rmtree(training.folder.best)
    waiting = Training.resume(tmp_path / 'run', device='cpu')
    assert 'best_validation' not in waiting.status()
    waiting.save()
    assert validated(3.0)
    assert load_model(training.folder.best).training['best_validation']['mean'] == 3.0
    (training.folder.best / 'model.json').write_text('{}')
    assert validated(2.0)
