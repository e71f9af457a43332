# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Continuous and hybrid action spaces: commands there and back, the best of them, exploring."""
import itertools
import json

from dqn_policy_node import Policy
from dqn_policy_node.action_space import ACTION_SPACES, read_action_space
from dqn_policy_node.axis_actions import Continuous, Hybrid, Mode
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import (
    ModelDescription, Network, parse_convolutions, Preprocessing,
)
from hypothesis import given, settings, strategies
from msgs_bridge.errors import MessageError
from msgs_bridge.twists import Command
import numpy as np
import pytest
import torch
from trainer_node.action_values import action_values

AXES = [name for name, space in ACTION_SPACES.items() if space.kind != 'discrete']
TOY = Hybrid('toy', (
    Mode('stop', (0.0,), (0.0,)),
    Mode('turn', (0.5,), (-1.0, 0.0, 1.0)),
    Mode('any', (-1.0, 1.0), (-0.5, 0.5))))


def test_the_kinds_are_there():
    assert {ACTION_SPACES[name].kind for name in AXES} == {'continuous', 'hybrid'}
    assert {len(space) for space in ACTION_SPACES.values() if space.kind == 'discrete'} == {
        5, 7, 9, 11, 12}


@settings(deadline=None)
@given(strategies.floats(-0.8, 1.0), strategies.floats(-1.0, 1.0))
def test_every_command_within_the_axes_is_an_action(linear, angular):
    space = ACTION_SPACES['continuous']
    found = space.decode(space.encode(Command(linear, angular)))
    assert found == pytest.approx((linear, angular), abs=1e-6)
    # a twist has been through float32
    again = space.encode(Command(*map(float, np.float32(found))))
    assert space.decode(again) == pytest.approx(found, abs=1e-6)


@pytest.mark.parametrize('name', AXES)
def test_every_output_is_an_action_with_a_mirror_image(name):
    space = ACTION_SPACES[name]
    assert read_action_space(json.loads(json.dumps(space.to_json()))) == space
    assert len(space.names) == len(space) == len(set(space.names)) <= 64
    random = np.random.default_rng(0)
    actions = np.array([space.explore(random, 4.0) for _ in range(50)])
    assert actions.dtype == space.dtype and actions.shape[1:] == space.shape
    for action, mirrored in zip(actions, space.mirror(actions)):
        linear, angular = space.decode(action)
        assert space.decode(mirrored) == pytest.approx((linear, -angular), abs=1e-6)
        assert space.encode(Command(linear, angular)) == pytest.approx(action, abs=1e-5)
        assert set(space.chosen(action)) == {'chosen', 'chosen_second'}


def test_a_command_outside_is_foreign_and_a_little_outside_is_the_border():
    space = ACTION_SPACES['continuous']
    assert space.decode(space.encode(Command(1.005, -1.005))) == (1.0, -1.0)
    for command in (Command(-1.0, 0.0), Command(float('nan'), 0.0), Command(0.0, float('nan'))):
        with pytest.raises(MessageError, match="is no action of 'continuous'"):
            space.encode(command)
    with pytest.raises(MessageError, match="linear 0.1, angular 0.7 is no action of 'toy'"):
        TOY.encode(Command(0.1, 0.7))


def test_places_by_hand():
    assert TOY.names == (
        'stop', 'turn angular -1', 'turn angular 0', 'turn angular 1', 'any linear -1',
        'any linear 1', 'any angular -0.5', 'any angular 0.5')
    for command, places in (
            ((0.0, 0.0), (0, -1)), ((0.5, 0.25), (2.25, -1)), ((0.25, 0.25), (4.625, 6.75))):
        assert tuple(TOY.encode(Command(*command))) == places
        assert TOY.decode(np.array(places, np.float32)) == pytest.approx(command)
    assert TOY.chosen(np.array([4.625, 6.75], np.float32)) == {'chosen': 5, 'chosen_second': 7}


@pytest.mark.parametrize('space', [TOY, *(ACTION_SPACES[name] for name in AXES)])
def test_nothing_is_worth_more_than_the_best_action(space):
    random = np.random.default_rng(1)
    finder = action_values(space)
    outputs = torch.from_numpy(random.normal(size=(40, len(space))).astype(np.float32))
    best = finder.best(outputs)
    assert torch.allclose(finder.of(outputs, best), finder.highest(outputs))
    for row, values in enumerate(outputs.numpy()):
        assert np.array_equal(space.greedy(values), best[row].numpy())
    for _ in range(50):
        others = torch.from_numpy(np.array([space.explore(random) for _ in range(40)]))
        assert bool((finder.of(outputs, others) <= finder.highest(outputs) + 1e-5).all())
    # and among the nodes themselves, each of which is its own action, nothing is missed
    nodes = [space.encode(Command(*pair)) for mode in space.modes
             for pair in itertools.product(*mode.nodes)]
    assert len({tuple(node) for node in nodes}) == len(nodes)
    everything = torch.stack([
        finder.of(outputs, torch.from_numpy(np.tile(node, (40, 1)))) for node in nodes])
    assert torch.allclose(everything.amax(0), finder.highest(outputs))


def test_values_between_nodes_are_straight_lines_and_the_mean_of_the_axes():
    finder = action_values(TOY)
    outputs = torch.tensor([[10.0, 1.0, 2.0, 4.0, 0.0, 8.0, 100.0, 200.0]]).repeat(3, 1)
    actions = torch.tensor([[0.0, -1.0], [2.25, -1.0], [4.625, 6.75]])
    assert finder.of(outputs, actions).tolist() == [10.0, 2.5, (5.0 + 175.0) / 2]
    quantiles = torch.stack([outputs, -outputs], 2)
    assert finder.of(quantiles, actions)[1].tolist() == [2.5, -2.5]


def test_exploring_is_seeded_weighted_and_covers_the_axes():
    space = ACTION_SPACES['continuous']
    draws = [space.decode(space.explore(np.random.default_rng(seed), 1.0)) for seed in range(400)]
    assert draws[0] == space.decode(space.explore(np.random.default_rng(0), 1.0))
    linear, angular = np.array(draws).T
    assert linear.min() < -0.7 and linear.max() > 0.95 and 0.4 < (linear > 0).mean() < 0.6
    assert angular.min() < -0.9 and angular.max() > 0.9
    random = np.random.default_rng(2)
    weighted = [space.decode(space.explore(random, 16.0)).linear > 0 for _ in range(400)]
    assert np.mean(weighted) == pytest.approx(16 / 17, abs=0.04)
    random = np.random.default_rng(2)
    hybrid = ACTION_SPACES['hybrid']
    weighted = [hybrid.decode(hybrid.explore(random, 16.0)).linear > 0 for _ in range(400)]
    assert np.mean(weighted) == pytest.approx(32 / 34, abs=0.04)


def test_a_choice_of_modes_is_kept_to():
    space = ACTION_SPACES['seed5+any']
    table = tuple(number for number, single in enumerate(space.single) if single)
    assert table == (0, 1, 2, 3, 4)
    values = np.zeros(len(space), np.float32)
    values[2] = 1.0
    values[5:] = 9.0
    assert space.mode(space.greedy(values)) == 5
    assert space.decode(space.greedy(values, table)) == (0.0, -1.0)
    random = np.random.default_rng(0)
    assert {space.mode(space.explore(random, 1.0, table)) for _ in range(100)} == set(table)
    assert {space.mode(space.explore(random, 1.0, (5,))) for _ in range(20)} == {5}


@pytest.mark.parametrize('name', AXES)
def test_a_policy_acts_by_it(name):
    space = ACTION_SPACES[name]
    policy = Policy(ModelDescription(
        Network(parse_convolutions('4@4/4'), 8, dueling=True), Preprocessing(shrink=4), 1, space,
        0.08, 0.08), seed=0)
    frame = np.random.default_rng(0).integers(0, 256, (96, 96, 3), np.uint8)
    answer = policy.decide(frame)
    assert answer.q_values.shape == (len(space),)
    assert answer.command == space.decode(space.greedy(answer.q_values))
    policy.epsilon = 1.0
    assert len({policy.decide(frame).command for _ in range(20)}) > 5


@pytest.mark.parametrize(('values', 'told'), [
    ({'kind': 'continuous', 'name': 'x', 'linear': [0], 'angular': [0, 1]}, 'along linear'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [0, 1]}, 'KeyError'),
    ({'kind': 'continuous', 'name': 'x', 'linear': 3, 'angular': [0, 1]}, 'not a list'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [0, 'y'], 'angular': [0, 1]}, 'ValueError'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [0, 1], 'angular': [1, 0]}, 'rising'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [0, 2], 'angular': [0, 1]}, 'from -1 to 1'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [0, float('nan')], 'angular': [0, 1]},
     'from -1 to 1'),
    ({'kind': 'continuous', 'name': 7, 'linear': [0, 1], 'angular': [0, 1]}, 'must be texts'),
    ({'kind': 'continuous', 'name': 'x', 'linear': [n / 100 for n in range(0, 100, 2)],
      'angular': [n / 100 for n in range(0, 100, 2)]}, '100 actions; accepted: 1 to 64'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': []}, '0 actions'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': 7}, 'TypeError'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': [{'name': 'a'}]}, 'KeyError'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': [
        {'name': 'a', 'linear': [], 'angular': [0]}]}, 'without a node'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': [
        {'name': 'a', 'linear': [0], 'angular': [0]}] * 2}, 'name of its own'),
    ({'kind': 'hybrid', 'name': 'x', 'modes': [
        {'name': 'a' * 99, 'linear': [0], 'angular': [0]}]}, 'must be texts'),
])
def test_untrusted_spaces_are_refused_with_the_reason(values, told):
    with pytest.raises(ModelError, match=told):
        read_action_space(values)


def test_a_space_without_mirror_images_says_so():
    lonely = Continuous('x', (Mode('', (0.0, 1.0), (0.0, 1.0)),))
    with pytest.raises(ModelError, match='cannot be mirrored'):
        lonely.mirror(np.array([lonely.encode(Command(0.5, 0.5))]))
