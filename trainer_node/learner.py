# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Deep Q-learning: sample, target, loss, step (Nature 518, 529; the report, 2.2.1).

Each trick is named as in its paper and can be switched off without touching another.
"""
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.nn import functional

from dqn_policy_node.network import QNetwork
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.replay_buffer import Batch


class UpdateResult(NamedTuple):
    """
    Figures of one update.

    Attributes:
        loss: mean loss of the batch.
        td_error: mean size of the TD error.
        q_mean: mean Q-value of the actions in the batch.
        gradient_norm: norm of the gradient before clipping.
    """

    loss: float
    td_error: float
    q_mean: float
    gradient_norm: float


def choose_device(name: str) -> torch.device:
    """
    Return the device to learn on; 'auto' is CUDA or ROCm when there, the CPU otherwise.

    Raises:
        LearningError: the device is not there.
    """
    if name == 'auto':
        name = 'cuda' if torch.cuda.is_available() else 'cpu'
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise LearningError(f'device {name!r}: {str(error).splitlines()[0]}') from None
    return device


class Learner:
    """
    The networks, the optimizer and the update.

    With `bf16` the arithmetic is done by bfloat16 copies of the weights, made anew after every
    update, while the optimizer works on the float32 ones (arXiv 1710.03740). That is autocast by
    hand: it casts each weight once and not at every use.

    Attributes:
        online: the network that learns, float32.
        target: the network that judges; a copy of an earlier `online`.
        averaged: the averaged weights, None when they are off.
        updates: updates made.
    """

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Make the networks with random weights from PyTorch's generator."""
        self.settings = settings
        self.device = choose_device(device)
        description = settings.model_description()
        self.online = QNetwork(description).to(self.device)
        self._working = self.online
        self.target = QNetwork(description).to(self.device).requires_grad_(False)
        if settings.bf16:
            self._working = QNetwork(description).to(self.device).to_bfloat16()
            self.target.to_bfloat16()
        self.averaged: QNetwork | None = None
        if settings.weight_average:
            self.averaged = QNetwork(description).to(self.device).requires_grad_(False)
            self.averaged.load_state_dict(self.online.state_dict())
            self._averaged_parameters = list(self.averaged.parameters())
        self.updates = 0
        self._dropout = np.random.default_rng([settings.seed, 1])
        # walking the modules anew for every update takes longer than some of its arithmetic
        self._parameters = list(self.online.parameters())
        self._working_parameters = list(self._working.parameters())
        self._optimizer = torch.optim.Adam(
            self._parameters, settings.learning_rate, eps=settings.adam_epsilon, fused=True)
        self._loss = {'l1': functional.l1_loss, 'huber': functional.smooth_l1_loss}[settings.loss]
        self._copy_to_working()
        self.copy_to_target()

    def copy_to_target(self) -> None:
        """Let the target network be what the online network is now."""
        self.target.load_state_dict(self.online.state_dict())

    @torch.no_grad()
    def _copy_to_working(self) -> None:
        """Let the bfloat16 weights be what the float32 weights are now."""
        if self._working is not self.online:
            torch._foreach_copy_(self._working_parameters, self._parameters)

    def update(self, batch: Batch, learning_rate: float) -> UpdateResult:
        """
        Make one update.

        Raises:
            LearningError: the loss is not finite; the weights are as before the update.
        """
        observations, next_observations, actions, rewards, discounts = (
            torch.from_numpy(array).to(self.device) for array in (
                batch.observations, batch.next_observations, batch.actions, batch.rewards,
                batch.discounts))
        target = self._targets(next_observations, rewards, discounts)
        network = self._working
        q_values = network(network.prepare(observations), dropout=self._dropout)
        chosen = q_values.gather(1, actions.unsqueeze(1)).squeeze(1)
        loss = self._loss(chosen, target)
        for parameter in self._working_parameters:
            parameter.grad = None
        loss.backward()
        result = UpdateResult(*torch.stack([
            loss, (chosen - target).abs().mean(), chosen.mean(), self._clip_gradient()]).tolist())
        if not math.isfinite(result.loss + result.gradient_norm):
            raise LearningError(self._explain(batch, result))
        for group in self._optimizer.param_groups:
            group['lr'] = learning_rate
        self._optimizer.step()
        self._copy_to_working()
        self.updates += 1
        self._average()
        if (self.settings.target_update == 'updates'
                and self.updates % self.settings.target_every == 0):
            self.copy_to_target()
        return result

    @torch.no_grad()
    def _targets(
        self, next_observations: torch.Tensor, rewards: torch.Tensor, discounts: torch.Tensor,
    ) -> torch.Tensor:
        """Return reward plus discounted value of what came next, float32 (B,)."""
        x = self.target.prepare(next_observations)
        judged = self.target(x)
        if self.settings.double:
            best = self._working(x).argmax(1, keepdim=True)
            value = judged.gather(1, best).squeeze(1)
        else:
            value = judged.amax(1)
        return rewards + discounts * value

    @torch.no_grad()
    def _clip_gradient(self) -> torch.Tensor:
        """Hand the gradient to the optimizer, no longer than allowed; return its norm before."""
        gradients = [parameter.grad for parameter in self._working_parameters]
        if self._working is not self.online:
            for parameter in self._parameters:
                if parameter.grad is None:
                    parameter.grad = torch.empty_like(parameter)
            wide = [parameter.grad for parameter in self._parameters]
            torch._foreach_copy_(wide, gradients)
            gradients = wide
        norm = torch.stack(torch._foreach_norm(gradients)).norm()
        if norm > self.settings.gradient_clip:
            torch._foreach_mul_(gradients, self.settings.gradient_clip / norm)
        return norm

    @torch.no_grad()
    def _average(self) -> None:
        """Move the averaged weights towards the online ones, quickly while there are few."""
        if self.averaged is None:
            return
        decay = min(self.settings.weight_average, (1 + self.updates) / (10 + self.updates))
        torch._foreach_lerp_(self._averaged_parameters, self._parameters, 1 - decay)

    def acting_tensors(self) -> dict[str, torch.Tensor]:
        """Return a copy of the weights that act and are validated: the average when it is on."""
        network = self.averaged if self.averaged is not None else self.online
        return {
            name: tensor.detach().cpu().clone() for name, tensor in network.state_dict().items()}

    def _explain(self, batch: Batch, result: UpdateResult) -> str:
        """Return where a loss that is not finite comes from."""
        parts = [f'update {self.updates + 1}: the loss is {result.loss}, the norm of the gradient '
                 f'{result.gradient_norm}']
        if not np.isfinite(batch.rewards).all():
            parts.append('a reward in the batch is not finite')
        for what, network in (('online', self.online), ('target', self.target)):
            for name, tensor in network.named_parameters():
                if not torch.isfinite(tensor).all():
                    parts.append(f'{what} weights {name!r} are not finite')
        return '; '.join(parts)

    @property
    def random_state(self) -> dict[str, Any]:
        """Return the state of the generator of the dropout, JSON values."""
        return self._dropout.bit_generator.state

    @random_state.setter
    def random_state(self, state: dict[str, Any]) -> None:
        self._dropout.bit_generator.state = state

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Return every tensor of the networks and the optimizer by name."""
        state = {}
        for what, network in self._networks().items():
            for name, tensor in network.state_dict().items():
                state[f'{what}.{name}'] = tensor
        for name, parameter in self.online.named_parameters():
            for key, tensor in self._optimizer.state.get(parameter, {}).items():
                state[f'adam.{key}.{name}'] = tensor
        return {name: tensor.detach().cpu().float() for name, tensor in state.items()}

    def load_state(self, tensors: dict[str, torch.Tensor], updates: int) -> None:
        """
        Take over what `state_tensors` gave.

        Raises:
            KeyError: a tensor is missing.
        """
        for what, network in self._networks().items():
            network.load_state_dict(
                {name: tensors[f'{what}.{name}'] for name in network.state_dict()})
        self._optimizer.state.clear()
        for name, parameter in self.online.named_parameters():
            if f'adam.step.{name}' in tensors:
                # the fused kernel reads memory as it lies: the layout must be the weights' own
                self._optimizer.state[parameter] = {
                    'step': tensors[f'adam.step.{name}'].to(self.device).clone(),
                    **{key: torch.empty_like(parameter, requires_grad=False).copy_(
                        tensors[f'adam.{key}.{name}']) for key in ('exp_avg', 'exp_avg_sq')}}
        self._copy_to_working()
        self.updates = updates

    def _networks(self) -> dict[str, QNetwork]:
        networks = {'online': self.online, 'target': self.target}
        if self.averaged is not None:
            networks['averaged'] = self.averaged
        return networks
