# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The update, with targets worked out by hand, and that it learns."""
from dqn_policy_node.action_space import action_space
from dqn_policy_node.device import choose_device
from dqn_policy_node.errors import ModelError
from learning_cases import tiny
import numpy as np
import pytest
import torch
from trainer_node.errors import LearningError
from trainer_node.learner import LEARNERS, make_learner as learner_of
from trainer_node.losses import LOSSES
from trainer_node.replay_buffer import Batch


def make_learner(**changes):
    torch.manual_seed(0)
    return learner_of(tiny(quantiles=4, **changes), 'cpu')


def make_batch(size=6, seed=0, **changes):
    random = np.random.default_rng(seed)
    batch = Batch(
        random.integers(0, 256, (size, 2, 12, 12), np.uint8),
        random.integers(0, 5, size, np.uint8),
        random.normal(size=size).astype(np.float32),
        random.integers(0, 256, (size, 2, 12, 12), np.uint8),
        np.where(random.random(size) < 0.5, 0, 0.9).astype(np.float32))
    return batch._replace(**changes)


def values(network, observations):
    return network(network.prepare(torch.from_numpy(observations))).numpy()


def differ(network):
    """Make a target network that disagrees with the online one."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn_like(parameter) * 0.3)


@pytest.mark.parametrize('double', [False, True])
@pytest.mark.parametrize('loss', ['l1', 'huber'])
def test_loss_and_targets_by_hand(double, loss):
    learner = make_learner(double=double, loss=loss)
    differ(learner.target)
    batch = make_batch()
    with torch.no_grad():
        online = values(learner.online, batch.observations)
        next_online = values(learner.online, batch.next_observations)
        next_target = values(learner.target, batch.next_observations)
    expected_loss, expected_error, expected_q = [], [], []
    for index in range(6):
        chosen = (next_online if double else next_target)[index].argmax()
        target = batch.rewards[index] + batch.discounts[index] * next_target[index, chosen]
        q_value = online[index, batch.actions[index]]
        error = abs(q_value - target)
        expected_loss.append(error if loss == 'l1' else
                             0.5 * error ** 2 if error < 1 else error - 0.5)
        expected_error.append(error)
        expected_q.append(q_value)
    result = learner.update(batch, 1e-3)
    assert result['loss'] == pytest.approx(np.mean(expected_loss), rel=1e-5)
    assert result['td_error'] == pytest.approx(np.mean(expected_error), rel=1e-5)
    assert result['q_mean'] == pytest.approx(np.mean(expected_q), rel=1e-4, abs=1e-6)
    assert learner.updates == 1


@pytest.mark.parametrize('double', [False, True])
@pytest.mark.parametrize('loss', ['l1', 'huber'])
def test_quantile_loss_by_hand(double, loss):
    learner = make_learner(learner='qr_dqn', double=double, loss=loss)
    differ(learner.target)
    batch = make_batch()

    def quantiles(network, observations):
        return network.quantiles(network.prepare(torch.from_numpy(observations))).numpy()

    with torch.no_grad():
        online = quantiles(learner.online, batch.observations)
        next_online = quantiles(learner.online, batch.next_observations)
        next_target = quantiles(learner.target, batch.next_observations)
    assert online.shape == (6, 5, 4)
    losses, means = [], []
    for index in range(6):
        best = (next_online if double else next_target)[index].mean(axis=1).argmax()
        targets = batch.rewards[index] + batch.discounts[index] * next_target[index, best]
        own = online[index, batch.actions[index]]
        total = 0.0
        for place, value in enumerate(own):
            share = (2 * place + 1) / (2 * len(own))
            for target in targets:
                error = target - value
                size = abs(error)
                cost = size if loss == 'l1' else (
                    0.5 * size ** 2 if size < 1 else size - 0.5)
                total += abs(share - (error < 0)) * cost / len(targets)
        losses.append(total)
        means.append(own.mean())
    result = learner.update(batch, 1e-3)
    assert result['loss'] == pytest.approx(np.mean(losses), rel=1e-5)
    assert result['q_mean'] == pytest.approx(np.mean(means), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize('double', [False, True])
def test_targets_of_axes_by_hand(double):
    space = action_space('continuous')
    learner = make_learner(double=double, loss='l1', action_space='continuous')
    differ(learner.target)
    random = np.random.default_rng(3)
    commands = [space.explore(random) for _ in range(6)]
    batch = make_batch(actions=np.array(commands))
    with torch.no_grad():
        online = values(learner.online, batch.observations)
        next_online = values(learner.online, batch.next_observations)
        next_target = values(learner.target, batch.next_observations)

    def worth(outputs, places):
        # linear has outputs 0 to 6, angular 7 to 15
        return np.mean([np.interp(place, range(16), outputs) for place in places])

    errors = []
    for row in range(6):
        judge = (next_online if double else next_target)[row]
        best = judge[:7].argmax(), 7 + judge[7:].argmax()
        target = batch.rewards[row] + batch.discounts[row] * worth(next_target[row], best)
        errors.append(abs(worth(online[row], commands[row]) - target))
    assert learner.update(batch, 1e-3)['td_error'] == pytest.approx(np.mean(errors), rel=1e-4)


@pytest.mark.parametrize(('name', 'dueling'), [('dqn', False), ('dqn', True), ('qr_dqn', True)])
@pytest.mark.parametrize('space', ['continuous', 'hybrid'])
def test_what_pays_along_axes_is_found(name, dueling, space):
    """A bandit: what is paid for is gas 1 at an angular of -0.2, and less further away."""
    own = action_space(space)
    learner = make_learner(learner=name, loss='huber', hidden=32, dueling=dueling,
                           action_space=space)
    random = np.random.default_rng(0)
    observations = np.full((64, 2, 12, 12), 128, np.uint8)
    for _ in range(400):
        actions = np.array([own.explore(random) for _ in range(64)])
        commands = np.array([own.decode(action) for action in actions])
        rewards = (2 - abs(commands[:, 0] - 1) - 2 * abs(commands[:, 1] + 0.2)).astype(np.float32)
        learner.update(
            Batch(observations, actions, rewards, observations, np.zeros(64, np.float32)), 3e-3)
    with torch.no_grad():
        found = own.decode(own.greedy(values(learner.online, observations[:1])[0]))
    assert found == pytest.approx((1.0, -0.2))


@pytest.mark.parametrize('dueling', [False, True])
def test_a_q_value_is_the_mean_of_its_quantiles(dueling):
    network = make_learner(learner='qr_dqn', dueling=dueling).online
    seen = network.prepare(torch.from_numpy(make_batch().observations))
    with torch.no_grad():
        assert network(seen).shape == (6, 5)
        assert torch.allclose(network(seen), network.quantiles(seen).mean(2))


def test_quantiles_tell_a_gamble_from_a_sure_thing():
    learner = make_learner(learner='qr_dqn', loss='huber', hidden=16)
    random = np.random.default_rng(0)
    observations = np.full((64, 2, 12, 12), 128, np.uint8)
    for _ in range(300):
        actions = random.integers(0, 2, 64, np.uint8)
        rewards = np.where(actions == 0, 0.5, random.integers(0, 2, 64) * 2).astype(np.float32)
        learner.update(
            Batch(observations, actions, rewards, observations, np.zeros(64, np.float32)), 1e-2)
    with torch.no_grad():
        seen = learner.online.prepare(torch.from_numpy(observations[:1]))
        sure, gamble = learner.online.quantiles(seen)[0, :2].numpy()
    assert sure.max() - sure.min() < 0.3
    assert gamble.max() - gamble.min() > 1.2
    assert gamble.mean() == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize('name', LOSSES)
def test_losses_are_elementwise_and_keep_the_shape(name):
    error = torch.tensor([[-3.0, -0.5, 0.0], [0.5, 1.0, 2.0]])
    expected = {'l1': [[3, 0.5, 0], [0.5, 1, 2]],
                'huber': [[2.5, 0.125, 0], [0.125, 0.5, 1.5]]}[name]
    assert LOSSES[name](error).tolist() == expected


def test_dueling_adds_value_and_centred_advantage():
    learner = make_learner(dueling=True)
    network = learner.online
    observations = torch.from_numpy(make_batch().observations)
    with torch.no_grad():
        hidden = torch.relu(network.hidden(torch.relu(
            network.convolutions[0](observations / 255)).permute(0, 2, 3, 1).flatten(1)))
        value, advantage = network.value(hidden[:, :4]), network.advantage(hidden[:, 4:])
        expected = value + advantage - advantage.mean(1, keepdim=True)
        assert torch.allclose(network(network.prepare(observations)), expected, atol=1e-5)


def test_the_gradient_is_clipped():
    learner, free = make_learner(gradient_clip=0.001), make_learner(gradient_clip=1e6)
    batch = make_batch(rewards=np.full(6, 50, np.float32))
    assert learner.update(batch, 1e-3)['grad_norm'] == pytest.approx(
        free.update(batch, 1e-3)['grad_norm'])
    clipped = torch.cat([p.grad.flatten() for p in learner.online.parameters()])
    assert clipped.norm().item() == pytest.approx(0.001, rel=1e-3)


def test_wider_pixels_learn_as_a_network_that_does_not_scale_them():
    learner = make_learner(pixel_range=255.0, loss='l1', gradient_clip=0.5)
    own = learner.online
    parameters = [parameter.detach().clone() for parameter in own.parameters()]
    parameters[0] /= 255
    for parameter in parameters:
        parameter.requires_grad_(True)
    adam = torch.optim.Adam(parameters, 1e-3)
    batch = make_batch(discounts=np.zeros(6, np.float32))
    for _ in range(4):
        x = torch.from_numpy(batch.observations).float()
        x = torch.relu(torch.nn.functional.conv2d(x, *parameters[:2], own.convolutions[0].stride))
        x = torch.relu(torch.nn.functional.linear(
            x.permute(0, 2, 3, 1).flatten(1), *parameters[2:4]))
        q_values = torch.nn.functional.linear(x, *parameters[4:])
        chosen = q_values[range(6), batch.actions.tolist()]
        adam.zero_grad()
        (chosen - torch.from_numpy(batch.rewards)).abs().mean().backward()
        norm = torch.nn.utils.clip_grad_norm_(parameters, 0.5)
        adam.step()
        assert learner.update(batch, 1e-3)['grad_norm'] == pytest.approx(norm.item(), rel=1e-3)
    parameters[0].detach().mul_(255)
    for mine, theirs in zip(own.parameters(), parameters):
        assert torch.allclose(mine, theirs, rtol=1e-3, atol=1e-5)


def test_the_target_network_waits():
    learner = make_learner(target_update='updates', target_every=3)
    first = learner.target.hidden.weight.clone()
    for update in range(1, 4):
        learner.update(make_batch(seed=update), 1e-2)
        same = torch.equal(learner.target.hidden.weight, first)
        assert same is (update < 3)
    assert torch.equal(learner.target.hidden.weight, learner.online.hidden.weight)


def test_the_average_lags_behind_and_acts():
    learner = make_learner(weight_average=0.5)
    expected = learner.online.hidden.weight.detach().clone()
    for update in range(1, 21):
        learner.update(make_batch(seed=update), 1e-2)
        decay = min(0.5, (1 + update) / (10 + update))
        expected += (1 - decay) * (learner.online.hidden.weight.detach() - expected)
    assert torch.allclose(learner.acting_tensors()['hidden.weight'], expected, atol=1e-6)
    assert not torch.allclose(expected, learner.online.hidden.weight)


def test_acting_tensors_are_copies():
    learner = make_learner()
    tensors = learner.acting_tensors()
    before = tensors['hidden.weight'].clone()
    learner.update(make_batch(), 1e-2)
    assert torch.equal(tensors['hidden.weight'], before)


@pytest.mark.parametrize('learner', LEARNERS)
@pytest.mark.parametrize('bf16', [False, True])
def test_each_learner_learns_which_action_pays(learner, bf16):
    learner = make_learner(learner=learner, bf16=bf16, loss='huber', dropout=0.0)
    random = np.random.default_rng(0)
    for _ in range(400):
        dark = random.random(32) < 0.5
        observations = np.where(dark, 30, 220).astype(np.uint8)[:, None, None, None]
        observations = np.broadcast_to(observations, (32, 2, 12, 12)).copy()
        actions = random.integers(0, 5, 32, np.uint8)
        rewards = np.where(actions == np.where(dark, 1, 3), 1, -1).astype(np.float32)
        learner.update(
            Batch(observations, actions, rewards, observations, np.zeros(32, np.float32)), 5e-3)
    with torch.no_grad():
        for level, best in ((30, 1), (220, 3)):
            q_values = values(learner.online, np.full((1, 2, 12, 12), level, np.uint8))[0]
            assert q_values.argmax() == best
            assert q_values[best] == pytest.approx(1, abs=0.25)


def test_a_loss_that_is_not_finite_stops_with_the_reason_and_the_weights_as_they_were():
    learner = make_learner()
    before = learner.acting_tensors()
    batch = make_batch()
    batch.rewards[2] = np.nan
    with pytest.raises(LearningError, match='update 1: the loss is nan.*a reward in the batch'):
        learner.update(batch, 1e-3)
    assert all(torch.equal(t, before[name]) for name, t in learner.acting_tensors().items())
    assert learner.updates == 0
    with torch.no_grad():
        learner.target.hidden.bias[0] = float('inf')
    with pytest.raises(LearningError, match="target weights 'hidden.bias' are not finite"):
        learner.update(make_batch(discounts=np.ones(6, np.float32)), 1e-3)


@pytest.mark.parametrize('name', LEARNERS)
def test_the_layout_is_the_fast_one_and_survives_a_restore(name):
    learner, other = (make_learner(
        learner=name, convolutions='4@4/2 8@3/1', dropout=0.3) for _ in range(2))
    weight = learner.online.convolutions[1].weight
    assert weight.is_contiguous(memory_format=torch.channels_last)
    for update in range(3):
        learner.update(make_batch(seed=update), 1e-2)
    other.load_state(
        {name: tensor.contiguous() for name, tensor in learner.state_tensors().items()}, 3)
    other.random_state = learner.random_state
    for update in range(3, 6):
        assert learner.update(make_batch(seed=update), 1e-2) == other.update(
            make_batch(seed=update), 1e-2)
    for name, tensor in learner.state_tensors().items():
        assert torch.equal(tensor, other.state_tensors()[name])


def test_the_figures_are_those_that_were_announced():
    for name in LEARNERS:
        learner = make_learner(learner=name)
        assert tuple(learner.update(make_batch(), 1e-3)) == learner.FIGURES


def test_a_device_that_is_not_there_is_one_line():
    assert choose_device('auto').type in ('cpu', 'cuda')
    # the last is a device, of which there are not that many
    for name in ('abacus', '', 'cuda:63'):
        with pytest.raises(ModelError, match=f"device is '{name}'.*accepted: auto, cpu, cuda"):
            choose_device(name)


@pytest.mark.parametrize('flush', [False, True])
def test_means_of_gradients_of_dead_units_end_at_zero(flush):
    learner = make_learner(flush_denormals=flush)
    learner.update(make_batch(), 1e-3)
    state = learner.state_tensors()
    name = 'adam.exp_avg.hidden.weight'
    learner.load_state({**state, name: torch.full_like(state[name], 1e-39)}, 1)
    with torch.no_grad():
        # no unit is active, so no weight of theirs has a gradient
        learner.online.hidden.bias.fill_(-1e6)
    learner.update(make_batch(), 1e-3)
    mean = learner.state_tensors()[name]
    assert bool((mean == 0).all()) == flush
    # what else this thread computes is as ever, the physics of a simulator for one
    assert torch.tensor(1e-39) * 0.5 > 0
