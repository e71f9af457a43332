# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The same laps over topics."""
import dataclasses
from pathlib import Path
import signal

from carracing_dqn.bringup.graph_laps import run_graph
from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.policies import PolicySource
from carracing_dqn.evaluation.through_graph import consecutive, drive_laps_through_graph
from dqn_policy_node.model_folder import Model, save_model
from dqn_policy_node.network import QNetwork
from dqn_policy_node.weights_message import encode_weights
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.step import EPISODE_CORE
import pytest
from std_msgs.msg import UInt8MultiArray
import torch
from trainer_node.hyperparameters import Hyperparameters

MODEL = PolicySource('model', 'some_model')


def summary(seed):
    return {**dict.fromkeys(EPISODE_CORE, 0.0), 'seed': float(seed), 'step': 1000.0,
            'episode_return': 900.1 + 1e-9, 'tiles_total': 300.0, 'lap_finished': 1.0,
            'tiles_visited': 0.0, 'left_field': 0.0, 'standing_still': 0.0}


def test_seeds_are_driven_in_stretches():
    assert consecutive([1, 2, 3, 7, 9, 10]) == [range(1, 4), range(7, 8), range(9, 11)]
    assert consecutive([]) == []
    asked = []

    def drive(model, seeds, bag):
        asked.append((model, seeds, bag))
        yield from map(summary, seeds)

    laps = list(drive_laps_through_graph(MODEL, [5, 6, 8], drive))
    assert asked == [('some_model', range(5, 7), None), ('some_model', range(8, 9), None)]
    assert [lap.seed for lap in laps] == [5, 6, 8]
    assert laps[0].episode_return == 900.1 and laps[0].lap_finished is True
    asked.clear()
    list(drive_laps_through_graph(PolicySource('random'), [5, 6], drive))
    assert asked == [('random', range(5, 6), None), ('random', range(6, 7), None)]


@pytest.mark.parametrize(('driven', 'message'), [
    ([4], 'drove track 4; expected 5'), ([5], 'before it had driven track 6'),
    ([5, 6, 7], 'drove track 7; expected None')])
def test_laps_that_were_not_asked_for_are_noticed(driven, message):
    with pytest.raises(EvaluationError, match=message):
        list(drive_laps_through_graph(MODEL, [5, 6], lambda *_: map(summary, driven)))


@pytest.mark.parametrize('frames', [float('nan'), float('inf'), 0.0, -5.0, 1e9, None])
def test_laps_of_no_length_are_noticed(frames):
    told = {**summary(5), 'step': frames}
    if frames is None:
        del told['step']
    with pytest.raises(EvaluationError, match='says that track 5 took'):
        list(drive_laps_through_graph(MODEL, [5], lambda *_: iter([told])))


def test_values_that_nobody_need_say_are_left_out_where_they_cannot_be():
    told = {**summary(5), 'tiles_total': 0.0, 'standing_still': float('inf'),
            'lap_finished': float('nan')}
    found, = drive_laps_through_graph(MODEL, [5], lambda *_: iter([told]))
    assert (found.tiles_total, found.tiles_visited, found.standing_still, found.lap_finished) == (
        None, None, None, None)


def test_a_model_that_is_replaced_meanwhile_is_not_taken_for_the_one_before(tmp_path):
    torch.manual_seed(1)
    description = Hyperparameters().model_description()

    def save():
        save_model(tmp_path / 'best', Model(
            description, dict(QNetwork(description).state_dict())))

    save()
    source = PolicySource('model', str(tmp_path / 'best'))
    source = dataclasses.replace(source, weights_sha256=source.identity()['weights_sha256'])
    source.open()
    save()
    with pytest.raises(EvaluationError, match='was replaced by another version'):
        source.open()
    with pytest.raises(EvaluationError, match='was replaced by another version'):
        list(drive_laps_through_graph(source, [5], lambda *_: map(summary, [5])))


def test_what_the_graph_cannot_do_is_said(tmp_path):
    with pytest.raises(EvaluationError, match='no node'):
        list(drive_laps_through_graph(PolicySource('a:b'), [1], None))
    with pytest.raises(EvaluationError, match='2'):
        list(drive_laps_through_graph(MODEL, [1, 3], None, bag=tmp_path / 'bag'))
    with pytest.raises(BridgeError, match='exists already'):
        list(run_graph('random', range(1), tmp_path))
    with pytest.raises(BridgeError, match='there is no folder'):
        list(run_graph('random', range(1), tmp_path / 'no' / 'bag'))


def test_laps_over_topics_are_those_in_process(tmp_path):
    source = PolicySource('random')
    bag = tmp_path / 'bag'
    over_topics = list(drive_laps_through_graph(source, [11], run_graph, bag=bag))
    assert over_topics == list(drive_laps(source, [11], simulator='fast'))
    assert (bag / 'metadata.yaml').is_file()


def test_the_validator_answers_while_it_drives(graph):
    description = Hyperparameters(convolutions='8@8/4', hidden=16).model_description()
    graph.listen(topics.DIAGNOSTICS, topics.VALIDATION)
    weights = graph.publisher(topics.WEIGHTS)
    validator = graph.node('carracing_dqn.evaluation.node', 'validator', tracks=1000)
    graph.spin_until(weights.get_subscription_count, 30, 'the validator')

    weights.publish(UInt8MultiArray(data=encode_weights(
        QNetwork(description).state_dict(), description, version=1, validate=True)))
    graph.spin_until(
        lambda: graph.health('validation_node').get('version') == '1', 30, 'version 1')
    before = len(graph.messages[topics.DIAGNOSTICS.name])
    graph.spin_until(
        lambda: len(graph.messages[topics.DIAGNOSTICS.name]) > before + 3, 20, 'diagnostics')
    assert not graph.messages[topics.VALIDATION.name]
    validator.signal(signal.SIGINT)
    assert validator.process.wait(10) == 0


def test_a_simulator_is_validated_in_the_thread_that_made_it(graph, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parent))
    description = Hyperparameters(
        convolutions='8@8/4', hidden=16, frame_height=32, frame_width=48).model_description()
    graph.listen(topics.VALIDATION)
    weights = graph.publisher(topics.WEIGHTS)
    graph.node('carracing_dqn.evaluation.node', 'validator', tracks=2,
               simulator='toy_simulator:Toy')
    graph.spin_until(weights.get_subscription_count, 30, 'the validator')
    weights.publish(UInt8MultiArray(data=encode_weights(
        QNetwork(description).state_dict(), description, version=1, validate=True)))
    graph.spin_until(lambda: graph.messages[topics.VALIDATION.name], 30, 'a validation')


def test_a_simulator_that_is_not_there_ends_the_validator_with_one_line(graph):
    validator = graph.node('carracing_dqn.evaluation.node', 'validator', simulator='nowhere:Toy')
    assert validator.process.wait(30) == 2
    words = validator.log.read_text()
    assert 'Traceback' not in words and 'nowhere' in words


def test_the_validator_drives_the_newest_version_that_waits(graph):
    description = Hyperparameters(convolutions='8@8/4', hidden=16).model_description()
    graph.listen(topics.DIAGNOSTICS, topics.VALIDATION)
    weights = graph.publisher(topics.WEIGHTS)
    graph.node('carracing_dqn.evaluation.node', 'validator', tracks=1)
    graph.spin_until(weights.get_subscription_count, 30, 'the validator')
    for version in range(1, 8):
        weights.publish(UInt8MultiArray(data=encode_weights(
            QNetwork(description).state_dict(), description, version=version, validate=True)))
    graph.spin_until(lambda: any(
        dict(zip(message.name, message.position))['version'] == 7
        for message in graph.messages[topics.VALIDATION.name]), 60, 'version 7')
    assert len(graph.messages[topics.VALIDATION.name]) <= 3
