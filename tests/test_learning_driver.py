# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which a run is driven: weights out, validations in, checkpoints, the end."""
import dataclasses
import subprocess
import sys

from carracing_dqn.bringup.training_display import model_score
from dqn_policy_node.model_folder import load_model
from dqn_policy_node.weights_message import decode_weights
from learning_cases import create, rows, stream, validation
from msgs_bridge.twists import Command
import pytest
import torch
from trainer_node.driver import Driver
from trainer_node.errors import LearningError, RunError
from trainer_node.training import Training


class Graph:
    """Takes weights, and answers those that ask for a validation when it is told to."""

    def __init__(self, *, at_once=False):
        self.updates, self.said, self.warned = [], [], []
        self.at_once = at_once

    def publish(self, data):
        self.updates.append(decode_weights(data))
        if self.at_once and self.updates[-1].validate:
            return validation(self.updates[-1].version)
        return None

    def driver(self, training, **options):
        return Driver(training, self.publish, say=self.said.append,
                      warn=lambda _, text: self.warned.append(text), **options)


def feed(driver, transitions):
    for transition in transitions:
        driver.add(transition)
        if not driver.turn():
            break


def test_weights_go_out_from_the_first_moment_on(tmp_path):
    graph = Graph()
    feed(graph.driver(create(tmp_path / 'run', validation_every_episodes=0)), stream(60))
    assert [update.version for update in graph.updates] == list(range(1, len(graph.updates) + 1))
    assert len(graph.updates) > 5 and not any(update.validate for update in graph.updates)


def test_validations_may_come_at_once_or_later(tmp_path):
    for at_once in (True, False):
        graph = Graph(at_once=at_once)
        driver = graph.driver(create(tmp_path / str(at_once)))
        feed(driver, stream(13 * 3 + 1))
        asked, = [update.version for update in graph.updates if update.validate]
        if not at_once:
            assert not driver.training.folder.best.exists()
            driver.validated(validation(asked))
            assert driver.turn()
        driver.turn()
        assert load_model(driver.training.folder.best).version == asked
        assert f'version {asked} is the best so far: {10 * asked:.1f}' in graph.said


def test_a_complete_run_waits_for_the_validation_of_its_last_weights(tmp_path):
    graph = Graph()
    driver = graph.driver(
        create(tmp_path / 'run', run_decisions=40, validation_every_episodes=0),
        last_validation_seconds=60.0)
    feed(driver, stream(40))
    assert driver.ended and not driver.done
    assert graph.updates[-1].validate
    feed(driver, stream(40, seed=1))
    assert driver.training.decisions == 40
    driver.validated(validation(graph.updates[-1].version - 1))
    driver.validated({'version': 1})
    assert driver.turn()
    assert 'left out: validation lacks' in graph.warned[-1]
    driver.validated(validation(graph.updates[-1].version))
    assert not driver.turn()
    assert driver.close() == driver.training.folder.final
    assert len(rows(driver.training.folder.validation)) == 1


def test_a_validation_that_does_not_come_ends_the_wait(tmp_path):
    graph = Graph()
    driver = graph.driver(create(tmp_path / 'run', run_decisions=20),
                          last_validation_seconds=1e-9)
    feed(driver, stream(20))
    assert not driver.turn()
    assert graph.warned == ['no validation of the last weights came in time']


def test_a_recording_that_is_over_ends_the_run(tmp_path):
    graph = Graph(at_once=True)
    driver = graph.driver(create(tmp_path / 'run'), last_validation_seconds=60.0)
    feed(driver, stream(50))
    driver.end()
    while driver.turn():
        pass
    assert driver.close() == driver.training.folder.final
    assert driver.training.complete
    model = load_model(driver.training.folder.final)
    assert model.training['decisions'] == 50
    assert len(rows(driver.training.folder.validation)) == 2


def test_what_is_asked_for_is_done_at_the_next_turn(tmp_path):
    graph = Graph()
    driver = graph.driver(create(tmp_path / 'run', checkpoint_every_minutes=0.0))
    feed(driver, stream(30))
    driver.request_save()
    driver.request_validation()
    before = driver.training.folder.checkpoint.read_bytes()
    driver.turn()
    assert driver.training.folder.checkpoint.read_bytes() != before
    assert graph.updates[-1].validate
    assert graph.said == [f'saved {driver.training.folder.checkpoint}']


def test_what_is_asked_for_a_thousand_times_is_done_once(tmp_path):
    """Anybody may call the services of a trainer, and a checkpoint takes seconds."""
    graph = Graph()
    driver = graph.driver(create(tmp_path / 'run', checkpoint_every_minutes=0.0))
    versions = len(graph.updates)
    for _ in range(1000):
        driver.request_save()
        driver.request_validation()
        driver.validated(validation(10**6))
    assert driver._validations.qsize() == 100
    driver.turn()
    assert len(graph.said) == 1 and len(graph.updates) == versions + 1
    assert 'faster than they are taken' in graph.warned[0] and driver._validations.empty()
    driver.turn()
    assert len(graph.said) == 1


def test_checkpoints_are_written_by_the_clock(tmp_path):
    driver = Graph().driver(create(tmp_path / 'run', checkpoint_every_minutes=1.0))
    feed(driver, stream(150))
    assert 0 < Training.resume(tmp_path / 'run', device='cpu').decisions < 150


def test_what_cannot_be_used_is_told_and_the_run_goes_on(tmp_path):
    graph = Graph()
    driver = graph.driver(create(tmp_path / 'run'))
    for transition in stream(30):
        driver.add(dataclasses.replace(transition, command=Command(0.5, 0.123)))
        driver.add(transition)
    assert driver.training.decisions == 30
    assert driver.left_out == graph.warned[-1].removeprefix('left out: ')
    assert 'linear 0.5, angular 0.123 is no action of' in driver.left_out
    assert driver.status['foreign_actions'] >= 20


def test_learning_that_cannot_go_on_ends_it_with_the_reason(tmp_path):
    training = create(tmp_path / 'run', speed_weight=0.5)
    driver = Graph().driver(training)
    transition = next(stream(1))
    bare = dataclasses.replace(transition.step, info={})
    with pytest.raises(LearningError, match="speed_weight is 0.5 and needs 'speed'"):
        driver.add(dataclasses.replace(transition, step=bare))
    with pytest.raises(RunError, match='learning has failed'):
        driver.close()


def test_a_run_that_was_stopped_goes_on_and_one_that_ended_has_a_model(tmp_path):
    driver = Graph().driver(create(tmp_path / 'run'))
    feed(driver, stream(30))
    assert driver.close() == driver.training.folder.checkpoint
    assert not driver.training.folder.final.exists()
    later = Training.resume(tmp_path / 'run', device='cpu')
    assert torch.equal(
        later.learning.learner.acting_tensors()['hidden.weight'],
        driver.training.learning.learner.acting_tensors()['hidden.weight'])


def test_both_models_of_a_run_say_what_validation_said_of_them_without_torch(tmp_path):
    for answered, score in ((True, ' (validation '), (False, ' (not validated)')):
        graph = Graph(at_once=answered)
        driver = graph.driver(create(tmp_path / str(answered), validation_every_episodes=0),
                              last_validation_seconds=0.001)
        feed(driver, stream(30))
        driver.end()
        while driver.turn():
            pass
        assert model_score(driver.close()).startswith(score)
        assert graph.warned == ([] if answered else [
            'no validation of the last weights came in time'])
    assert model_score(tmp_path) == ' (not validated)'
    code = ('import sys; from carracing_dqn.bringup.training_display import model_score; '
            f'print(model_score({str(tmp_path / "True" / "final")!r}), "torch" in sys.modules)')
    said = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert said.stdout.startswith(' (validation ') and said.stdout.endswith(') False\n'), said
