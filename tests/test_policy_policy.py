# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Policies: stacking, holding, exploring, swapping."""
import itertools
import subprocess
import sys

from dqn_policy_node import load_policy, ModelError, Policy, RandomPolicy
from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.model_description import (
    ModelDescription, Network, parse_convolutions, Preprocessing,
)
from dqn_policy_node.model_folder import Model, save_model
from dqn_policy_node.network import QNetwork
from dqn_policy_node.weights_message import WeightsUpdate
import numpy as np
import pytest
import torch

DESCRIPTION = ModelDescription(
    Network(parse_convolutions('4@4/4 4@3/2'), 8, dropout=0.5), Preprocessing(shrink=4), 3,
    ACTION_SPACES['seed5'], 0.08, 0.08)


def frames(count):
    return np.random.default_rng(1).integers(0, 256, (count, 96, 96, 3), np.uint8)


def weights(seed, **values):
    torch.manual_seed(seed)
    return WeightsUpdate(QNetwork(DESCRIPTION).state_dict(), DESCRIPTION, version=seed, **values)


def test_act_decides_once_and_holds():
    policy, other = Policy(DESCRIPTION), Policy(DESCRIPTION)
    update = weights(1)
    policy.swap_weights(update)
    other.swap_weights(update)
    policy.reset()
    observations = frames(12)
    acted = [policy.act(frame) for frame in observations]
    decided = [other.decide(frame).command for frame in observations[::4]]
    assert acted == [action for action in decided for _ in range(4)]
    assert all(isinstance(value, float) for value in acted[0])


def test_a_reset_forgets_frames_and_held_action():
    policy = Policy(DESCRIPTION)
    policy.swap_weights(weights(1))
    observations = frames(6)
    first = [policy.decide(frame).q_values for frame in observations[:2]]
    policy.act(observations[5])
    policy.reset()
    again = [policy.decide(frame).q_values for frame in observations[:2]]
    assert np.array_equal(first, again)


def test_a_decision_is_the_best_q_value():
    policy = Policy(DESCRIPTION)
    decision = policy.decide(frames(1)[0])
    assert decision.action == decision.q_values.argmax()
    assert decision.command == DESCRIPTION.action_space.decode(decision.action)
    assert decision.explored is False
    assert decision.q_values.shape == (5,)
    assert policy.action_names == ('none', 'left', 'right', 'gas', 'brake')


def test_exploration_is_seeded_and_weighted():
    policy = Policy(DESCRIPTION, seed=5)
    policy.swap_weights(weights(1, epsilon=1.0, gas_weight=16.0))
    frame = frames(1)[0]
    first = [policy.decide(frame) for _ in range(300)]
    assert all(decision.explored for decision in first)
    share = sum(decision.action == 3 for decision in first) / 300
    assert 0.7 < share < 0.9
    policy.reset(seed=5)
    assert [policy.decide(frame).action for _ in range(300)] == [d.action for d in first]


def test_a_random_action_may_be_held_for_a_drawn_number_of_decisions():
    policy = Policy(DESCRIPTION, seed=5)
    policy.swap_weights(weights(1, epsilon=0.1, exploration_hold=6))
    frame = frames(1)[0]
    decisions = [policy.decide(frame) for _ in range(6000)]
    runs = [list(run) for explored, run in itertools.groupby(decisions, lambda d: d.explored)
            if explored]
    # two explorations may follow each other, so the longest run is no bound
    held = [len(list(same)) for run in runs for _, same in itertools.groupby(
        run, lambda d: d.action)]
    assert 0.5 < np.mean([length == 1 for length in held]) < 0.7
    assert np.sum([length >= 6 for length in held]) > 5 and max(held) <= 12
    policy.reset()
    policy.epsilon = 0.0
    assert not policy.decide(frame).explored


def test_epsilon_is_the_share_of_random_actions():
    policy = Policy(DESCRIPTION, seed=0)
    policy.epsilon = 0.3
    frame = frames(1)[0]
    assert 0.2 < np.mean([policy.decide(frame).explored for _ in range(400)]) < 0.4


def test_swapped_weights_act_from_the_next_decision_on():
    policy, fresh = Policy(DESCRIPTION), Policy(DESCRIPTION)
    observations = frames(3)
    policy.swap_weights(weights(1))
    policy.decide(observations[0])
    policy.swap_weights(weights(2, epsilon=0.5))
    policy.epsilon = 0.0
    fresh.swap_weights(weights(2))
    fresh.decide(observations[0])
    assert policy.version == 2
    assert np.array_equal(
        policy.decide(observations[1]).q_values, fresh.decide(observations[1]).q_values)


def test_weights_of_another_model_are_refused():
    update = weights(1)
    other = ModelDescription(
        DESCRIPTION.network, DESCRIPTION.preprocessing, 3, ACTION_SPACES['grid9'], 0.08, 0.08)
    with pytest.raises(ModelError, match='another model: action_space'):
        Policy(other).swap_weights(update)


def test_load_policy_is_greedy_and_has_the_version(tmp_path):
    save_model(tmp_path / 'm', Model(DESCRIPTION, weights(4).tensors, {}, 4))
    policy = load_policy(tmp_path / 'm')
    assert (policy.version, policy.epsilon, policy.action_repeat) == (4, 0.0, 4)


def test_the_dummy_agent_draws_all_actions_alike():
    policy = RandomPolicy(ACTION_SPACES['seed5'], seed=3)
    frame = frames(1)[0]
    counts = np.bincount([policy.decide(frame).action for _ in range(1000)], minlength=5)
    assert counts.min() > 150
    policy.reset(seed=3)
    assert policy.act(frame) in ACTION_SPACES['seed5'].commands


def test_dropout_drops_its_share_and_only_when_asked():
    network = QNetwork(DESCRIPTION)
    observations = torch.from_numpy(frames(1)[..., 0]).repeat(1, 3, 1, 1)[:, :, ::4, ::4]
    observations = network.prepare(observations)
    assert torch.equal(network(observations), network(observations))
    random = np.random.default_rng(0)
    outputs = [network(observations, dropout=random) for _ in range(400)]
    assert not torch.equal(outputs[0], outputs[1])
    from dqn_policy_node.network import _dropout_mask
    mask = _dropout_mask(torch.zeros(8, 4, 9, 9), 0.25, random)
    assert abs(mask.mean().item() - 1) < 0.05
    assert mask.unique().tolist() == pytest.approx([0.0, 256 / 192])


def test_the_package_does_not_load_torch_before_it_is_needed():
    code = 'import dqn_policy_node, trainer_node, sys; sys.exit("torch" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code], timeout=60).returncode == 0
