# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Action spaces and model descriptions: what is accepted, and what is said when it is not."""
import json

from dqn_policy_node.action_space import (
    action_space, ACTION_SPACES, Discrete, read_action_space,
)
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import (
    Convolution, ModelDescription, Network, parse_convolutions, Preprocessing,
)
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command
import numpy as np
import pytest


def description(**changes):
    values = {
        'network': Network(parse_convolutions('4@4/2 8@3/1'), 16, True, 0.2),
        'preprocessing': Preprocessing(rows=24, columns=32, shrink=2),
        'frame_stack': 2, 'action_space': ACTION_SPACES['seed5'],
        'action_seconds': 0.08, 'stack_seconds': 0.08}
    return ModelDescription(**{**values, **changes})


def test_seed5_is_the_table_of_the_report():
    assert ACTION_SPACES['seed5'].commands == (
        (0, 0), (0, 1), (0, -1), (1, 0), (-0.8, 0))


@pytest.mark.parametrize('name', [
    name for name, space in ACTION_SPACES.items() if space.kind == 'discrete'])
def test_every_set_finds_its_own_actions_and_has_mirror_images(name):
    own = ACTION_SPACES[name]
    indices = np.arange(len(own), dtype=own.dtype)
    assert [own.encode(own.decode(index)) for index in indices] == list(indices)
    mirrored = own.mirror(indices)
    assert list(own.mirror(mirrored)) == list(indices)
    for index, other in enumerate(mirrored):
        linear, angular = own.decode(index)
        assert own.decode(other) == (linear, -angular)
    assert read_action_space(json.loads(json.dumps(own.to_json()))) == own


def test_encoding_forgives_float32_and_nothing_else():
    own = ACTION_SPACES['seed5']
    assert own.encode(Command(-0.800000012, 0.0)) == 4
    with pytest.raises(MessageError, match="linear 0.5, angular 0 is no action of 'seed5'"):
        own.encode(Command(0.5, 0.0))
    with pytest.raises(MessageError):
        own.encode(Command(float('nan'), 0.0))


@pytest.mark.parametrize(('rows', 'text'), [
    ([('a', 2, 0)], 'accepted: linear'),
    ([('a', 0, float('nan'))], 'accepted: linear'),
    ([], 'accepted: 1 to 64'),
    ([(str(number), 0, 0) for number in range(65)], '65 actions; accepted: 1 to 64'),
    ([('a', 0, 0), ('a', 1, 0)], 'name of its own'),
])
def test_impossible_tables_are_refused(rows, text):
    with pytest.raises(ModelError, match=text):
        Discrete('x', tuple(r[0] for r in rows), tuple(Command(*r[1:]) for r in rows))


def test_a_table_without_mirror_images_says_so():
    lonely = Discrete('x', ('left',), (Command(0.0, 1.0),))
    with pytest.raises(ModelError, match='cannot be mirrored'):
        lonely.mirror(np.zeros(1, np.uint8))
    with pytest.raises(ModelError, match='accepted: seed5'):
        action_space('seed6')


def test_a_description_survives_json():
    own = description()
    assert ModelDescription.from_json(json.loads(json.dumps(own.to_json()))) == own
    assert own.sha256() == description().sha256() != description(frame_stack=3).sha256()


def test_the_report_network_has_the_shapes_of_table_1():
    own = ModelDescription(
        Network(parse_convolutions('32@8/4 64@4/2 64@3/1'), 512), Preprocessing(), 1,
        ACTION_SPACES['seed5'], 0.02, 0.02)
    assert own.features == (64, 8, 8)
    assert own.shapes['convolutions.0.weight'] == (32, 1, 8, 8)
    assert own.shapes['hidden.weight'] == (512, 64 * 8 * 8)
    assert own.shapes['output.weight'] == (5, 512)


@pytest.mark.parametrize(('path', 'value', 'text'), [
    (('network', 'hidden'), 10**6, 'hidden is 1000000'),
    (('network', 'hidden'), 'x', "hidden is 'x'"),
    (('network', 'hidden'), 15, 'must be even'),
    (('network', 'dueling'), 1, 'dueling is 1'),
    (('network', 'dropout'), 1.5, 'dropout is 1.5'),
    (('network', 'dropout'), float('nan'), 'dropout is nan'),
    (('network', 'convolutions'), [], '0 convolutions'),
    (('network', 'convolutions'), 'abc', 'must be a list'),
    (('network', 'convolutions'), [{'filters': 1}], "lacks 'kernel', 'stride'"),
    (('network', 'convolutions'), [{'filters': 1, 'kernel': 30, 'stride': 1}], 'does not fit'),
    (('network',), [], 'network must be a mapping'),
    (('network', 'colour'), 1, "unknown 'colour'"),
    (('preprocessing', 'rows'), 97, 'rows is 97'),
    (('preprocessing', 'first_row'), 90, 'rows is 24; accepted: whole numbers from 1 to 6'),
    (('preprocessing', 'shrink'), 5, 'does not divide'),
    (('preprocessing', 'gray'), 'red', "gray is 'red'; accepted: mean, luma"),
    (('preprocessing', 'road'), 'wet', "road is 'wet'; accepted: plain, flat, contrast"),
    (('frame_stack',), 10**9, 'frame_stack'),
    (('frame_stack',), True, 'frame_stack is True'),
    (('action_seconds',), 0.0, 'action_seconds is 0.0'),
    (('action_seconds',), True, 'action_seconds is True'),
    (('stack_seconds',), float('nan'), 'stack_seconds is nan'),
    (('preprocessing', 'frame_height'), 5000, 'frame size across rows is 5000'),
    (('action_space',), [], 'action space of kind None; accepted: discrete'),
    (('action_space', 'actions'), 3, 'action space'),
    (('action_space', 'actions'), [{'name': 'a', 'linear': 'x', 'angular': 0}], 'action space'),
    (('action_space', 'name'), 7, 'names of actions'),
])
def test_untrusted_descriptions_are_refused_with_the_reason(path, value, text):
    values = json.loads(json.dumps(description().to_json()))
    place = values
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(ModelError, match=text):
        ModelDescription.from_json(values)


def test_no_description_asks_for_endless_memory():
    with pytest.raises(ModelError, match='weights; accepted: up to 50000000'):
        description(network=Network((Convolution(512, 1, 1),), 4096),
                    preprocessing=Preprocessing())


@pytest.mark.parametrize('text', ['32x8x4', '32@8', '32@8/4,', '99999@1/1'])
def test_convolutions_that_are_not_written_right_are_refused(text):
    with pytest.raises(ModelError, match='convolution|filters'):
        parse_convolutions(text)


def test_differences_name_the_value_and_both_sides():
    assert description().differences(description()) == []
    assert description().differences(description(frame_stack=3)) == ['frame_stack is 2, not 3']
    other = description(network=Network(parse_convolutions('4@4/2 8@3/1'), 32, True, 0.2))
    assert description().differences(other) == ['network.hidden is 16, not 32']


def test_a_description_of_version_0_1_is_read_as_today_s():
    old = description().to_json()
    space = old.pop('action_space')
    del old['action_seconds'], old['stack_seconds']
    del old['preprocessing']['frame_height'], old['preprocessing']['frame_width']
    pedals = {'none': (0, 0, 0), 'left': (-1, 0, 0), 'right': (1, 0, 0), 'gas': (0, 1, 0),
              'brake': (0, 0, 0.8)}
    old |= {'action_repeat': 4, 'stack_frames': 0, 'action_set': {
        'name': space['name'],
        'actions': [{'name': name, 'steer': steer, 'gas': gas, 'brake': brake}
                    for name, (steer, gas, brake) in pedals.items()]}}
    assert ModelDescription.from_json(old) == description()
    for name in old:
        with pytest.raises(ModelError):
            ModelDescription.from_json({**old, name: None})
