# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Action sets and model descriptions: what is accepted, and what is said when it is not."""
import json

from dqn_policy_node.action_sets import ACTION_SETS, action_set, ActionSet
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import (
    Convolution, ModelDescription, Network, parse_convolutions, Preprocessing,
)
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Action
import pytest


def description(**changes):
    values = {
        'network': Network(parse_convolutions('4@4/2 8@3/1'), 16, True, 0.2),
        'preprocessing': Preprocessing(rows=24, columns=32, shrink=2),
        'frame_stack': 2, 'action_set': ACTION_SETS['seed5'], 'action_repeat': 4}
    return ModelDescription(**{**values, **changes})


def test_seed5_is_the_table_of_the_report():
    assert ACTION_SETS['seed5'].actions == (
        (0, 0, 0), (-1, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0.8))


@pytest.mark.parametrize('name', ACTION_SETS)
def test_every_set_finds_its_own_actions_and_has_mirror_images(name):
    own = ACTION_SETS[name]
    assert [own.nearest(action) for action in own.actions] == list(range(len(own)))
    mirrored = own.mirrored()
    assert [mirrored[mirrored[index]] for index in range(len(own))] == list(range(len(own)))
    for index, other in enumerate(mirrored):
        assert own.actions[other].steer == -own.actions[index].steer
    assert ActionSet.from_json(json.loads(json.dumps(own.to_json()))) == own


def test_nearest_forgives_float32_and_nothing_else():
    own = ACTION_SETS['seed5']
    assert own.nearest(Action(0.0, 0.0, 0.800000012)) == 4
    with pytest.raises(MessageError, match="gas 0.5, brake 0 is no action of 'seed5'"):
        own.nearest(Action(0.0, 0.5, 0.0))
    with pytest.raises(MessageError):
        own.nearest(Action(float('nan'), 0.0, 0.0))


@pytest.mark.parametrize(('rows', 'text'), [
    ([('a', 0, 0.5, 0.5)], 'at once'),
    ([('a', 2, 0, 0)], 'accepted: steer'),
    ([], 'accepted: 1 to 64'),
    ([('a', 0, 0, 0), ('a', 1, 0, 0)], 'name of its own'),
])
def test_impossible_sets_are_refused(rows, text):
    with pytest.raises(ModelError, match=text):
        ActionSet('x', tuple(r[0] for r in rows), tuple(Action(*r[1:]) for r in rows))


def test_a_set_without_mirror_images_says_so():
    lonely = ActionSet('x', ('left',), (Action(-1.0, 0.0, 0.0),))
    with pytest.raises(ModelError, match='cannot be mirrored'):
        lonely.mirrored()
    with pytest.raises(ModelError, match='accepted: seed5'):
        action_set('seed6')


def test_a_description_survives_json():
    own = description()
    assert ModelDescription.from_json(json.loads(own.to_text())) == own
    assert own.sha256() == description().sha256() != description(frame_stack=3).sha256()


def test_the_report_network_has_the_shapes_of_table_1():
    own = ModelDescription(
        Network(parse_convolutions('32@8/4 64@4/2 64@3/1'), 512), Preprocessing(), 1,
        ACTION_SETS['seed5'], 1)
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
    (('action_repeat',), 0, 'action_repeat is 0'),
    (('stack_frames',), 51, 'stack_frames is 51'),
    (('action_set', 'actions'), 3, 'action set'),
    (('action_set', 'actions'), [{'name': 'a', 'steer': 'x', 'gas': 0, 'brake': 0}], 'action set'),
    (('action_set', 'name'), 7, 'names of actions'),
])
def test_untrusted_descriptions_are_refused_with_the_reason(path, value, text):
    values = json.loads(description().to_text())
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
