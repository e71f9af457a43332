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

    Attributes:
        online: the network that learns.
        target: the network that judges; a copy of an earlier `online`.
        updates: updates made.
    """

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Make the networks with random weights from PyTorch's generator."""
        self.settings = settings
        self.device = choose_device(device)
        description = settings.model_description()
        self.online = QNetwork(description).to(self.device)
        self.target = QNetwork(description).to(self.device).requires_grad_(False)
        self.averaged: QNetwork | None = None
        if settings.weight_average:
            self.averaged = QNetwork(description).to(self.device).requires_grad_(False)
            self.averaged.load_state_dict(self.online.state_dict())
        self.copy_to_target()
        self.updates = 0
        self._dropout = np.random.default_rng([settings.seed, 1])
        self._parameters = list(self.online.parameters())
        self._optimizer = torch.optim.Adam(
            self._parameters, settings.learning_rate, eps=settings.adam_epsilon, fused=True)
        self._loss = {'l1': functional.l1_loss, 'huber': functional.smooth_l1_loss}[settings.loss]

    def copy_to_target(self) -> None:
        """Let the target network be what the online network is now."""
        self.target.load_state_dict(self.online.state_dict())

    def update(self, batch: Batch, learning_rate: float) -> UpdateResult:
        """
        Make one update.

        Raises:
            LearningError: the loss is not finite; the weights are as before the update.
        """
        pictures, next_pictures, actions, rewards, discounts = (
            torch.from_numpy(array).to(self.device) for array in (
                batch.pictures, batch.next_pictures, batch.actions, batch.rewards,
                batch.discounts))
        actions = actions.unsqueeze(1)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.bf16):
            target = self._targets(next_pictures, rewards, discounts)
            values = self.online(pictures, dropout=self._dropout).gather(1, actions).squeeze(1)
        loss = self._loss(values, target)
        self._optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self._parameters, self.settings.gradient_clip)
        result = UpdateResult(
            loss.item(), (values.detach() - target).abs().mean().item(),
            values.detach().mean().item(), norm.item())
        if not math.isfinite(result.loss + result.gradient_norm):
            raise LearningError(self._explain(batch, result))
        for group in self._optimizer.param_groups:
            group['lr'] = learning_rate
        self._optimizer.step()
        self.updates += 1
        self._average()
        if (self.settings.target_update == 'updates'
                and self.updates % self.settings.target_every == 0):
            self.copy_to_target()
        return result

    @torch.no_grad()
    def _targets(
        self, next_pictures: torch.Tensor, rewards: torch.Tensor, discounts: torch.Tensor,
    ) -> torch.Tensor:
        """Return reward plus discounted value of what came next, float32 (B,)."""
        judged = self.target(next_pictures)
        if self.settings.double:
            chosen = self.online(next_pictures).argmax(1, keepdim=True)
            value = judged.gather(1, chosen).squeeze(1)
        else:
            value = judged.amax(1)
        return rewards + discounts * value

    @torch.no_grad()
    def _average(self) -> None:
        """Move the averaged weights towards the online ones, quickly while there are few."""
        if self.averaged is None:
            return
        decay = min(self.settings.weight_average, (1 + self.updates) / (10 + self.updates))
        torch._foreach_lerp_(
            list(self.averaged.parameters()), self._parameters, 1 - decay)

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
        return {name: tensor.detach().cpu() for name, tensor in state.items()}

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
        self.updates = updates

    def _networks(self) -> dict[str, QNetwork]:
        networks = {'online': self.online, 'target': self.target}
        if self.averaged is not None:
            networks['averaged'] = self.averaged
        return networks
