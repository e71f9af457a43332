# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What learners of action values share: online, target and averaged network, Adam, the update.

Each trick is named as in its paper and can be switched off without touching another.
"""
from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
import torch

from dqn_policy_node.device import choose_device
from dqn_policy_node.network import QNetwork
from trainer_node.action_values import action_values
from trainer_node.denormals import flushed_denormals
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.losses import LOSSES
from trainer_node.replay_buffer import Batch


class ValueLearner:
    """
    The networks, the optimizer and the update; a subclass says what the loss is.

    With `bf16` the arithmetic is done by bfloat16 copies of the weights, made anew after every
    update, while the optimizer works on the float32 ones (arXiv 1710.03740). That is autocast by
    hand: it casts each weight once and not at every use.

    Attributes:
        online: the network that learns, float32.
        working: the network that computes: `online` itself, or its bfloat16 copy.
        target: the network that judges; a copy of an earlier `online`.
        averaged: the averaged weights, None when they are off.
        actions: finds the values of actions in the outputs of a network.
        updates: updates made.
    """

    FIGURES: ClassVar[tuple[str, ...]] = ('loss', 'td_error', 'q_mean', 'grad_norm')

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Make the networks with random weights from PyTorch's generator."""
        self.settings = settings
        self.device = choose_device(device)
        description = settings.model_description()
        self.actions = action_values(description.action_space)
        self.online = QNetwork(description).to(self.device)
        self._widen_pixels()
        self.working = self.online
        self.target = QNetwork(description).to(self.device).requires_grad_(False)
        if settings.bf16:
            self.working = QNetwork(description).to(self.device).to_bfloat16()
            self.target.to_bfloat16()
        self.averaged: QNetwork | None = None
        if settings.weight_average:
            self.averaged = QNetwork(description).to(self.device).requires_grad_(False)
            self.averaged.load_state_dict(self.online.state_dict())
            self._averaged_parameters = list(self.averaged.parameters())
        self.updates = 0
        self.dropout = np.random.default_rng([settings.seed, 1])
        self.loss_of = LOSSES[settings.loss]
        # walking the modules anew for every update takes longer than some of its arithmetic
        self._parameters = list(self.online.parameters())
        self._working_parameters = list(self.working.parameters())
        self._optimizer = torch.optim.Adam(
            self._groups(), settings.learning_rate, eps=settings.adam_epsilon, fused=True)
        self._copy_to_working()
        self._copy_to_target()

    def _groups(self) -> list[Any]:
        """
        Return what Adam takes.

        The network scales pixels to 0..1 by way of the first weights. Of wider pixels those would
        be smaller and their gradients larger: steps so much longer are the same to the outputs.
        """
        wide = self.settings.pixel_range
        if wide == 1:
            return self._parameters
        first, *others = self._parameters
        return [{'params': [first], 'factor': wide, 'eps': self.settings.adam_epsilon / wide},
                {'params': others}]

    @torch.no_grad()
    def _widen_pixels(self) -> None:
        """Start the first layer as one whose pixels are 0 to `pixel_range`."""
        if self.settings.pixel_range != 1:
            self.online.convolutions[0].weight.mul_(self.settings.pixel_range)

    def _loss(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """
        Return loss, mean size of the TD error and mean Q-value of the actions, scalars.

        Args:
            batch: tensors on the learner's device.
        """
        raise NotImplementedError

    def _margin_loss(self, q_values: torch.Tensor, batch: Batch) -> torch.Tensor | float:
        """
        Return what it costs that demonstrated actions are not the best by a margin.

        The large margin loss of DQfD (arXiv 1704.03732), with its weight: the highest value, each
        raised by the margin but that of the demonstrated action, less the value of that.

        Args:
            q_values: of the online network, (B, outputs).
            batch: as `_loss` takes it.
        """
        count, settings = batch.demonstrated, self.settings
        if not count or not settings.demonstration_weight:
            return 0.0
        q_values, actions = q_values[:count], batch.actions[:count]
        raised = q_values + settings.demonstration_margin * self.actions.apart(
            actions, q_values.shape[1])
        lost = self.actions.highest(raised) - self.actions.of(q_values, actions)
        return settings.demonstration_weight * lost.sum() / len(batch.actions)

    def update(self, batch: Batch, learning_rate: float) -> dict[str, float]:
        """
        Make one update.

        Args:
            batch: what the replay buffer sampled.
            learning_rate: that of this update.

        Returns:
            `loss`, the mean of the batch; `td_error`, mean size of the TD error; `q_mean`, mean
            Q-value of the actions in the batch; `grad_norm`, before clipping.

        Raises:
            LearningError: the loss is not finite; the weights are as before the update.
        """
        with flushed_denormals(self.settings.flush_denormals):
            return self._update(batch, learning_rate)

    def _update(self, batch: Batch, learning_rate: float) -> dict[str, float]:
        """Make one update, as `update` describes it."""
        loss, td_error, q_mean = self._loss(
            Batch(*(torch.from_numpy(array).to(self.device) for array in batch[:-1]),
                  batch.demonstrated))
        for parameter in self._working_parameters:
            parameter.grad = None
        loss.backward()
        figures = torch.stack([
            loss.detach(), td_error.detach(), q_mean.detach(), self._clip_gradient()])
        result = dict(zip(self.FIGURES, figures.tolist()))
        if not math.isfinite(result['loss'] + result['grad_norm']):
            raise LearningError(self._explain(batch, result))
        for group in self._optimizer.param_groups:
            group['lr'] = learning_rate * group.get('factor', 1.0)
        self._optimizer.step()
        self._copy_to_working()
        self.updates += 1
        self._average()
        if (self.settings.target_update == 'updates'
                and self.updates % self.settings.target_every == 0):
            self._copy_to_target()
        return result

    def episode_ended(self, episodes: int) -> None:
        """Renew the target network where it waits for so many episodes."""
        if (self.settings.target_update == 'episodes'
                and episodes % self.settings.target_every == 0):
            self._copy_to_target()

    def _copy_to_target(self) -> None:
        """Let the target network be what the online network is now."""
        self.target.load_state_dict(self.online.state_dict())

    @torch.no_grad()
    def _copy_to_working(self) -> None:
        """Let the bfloat16 weights be what the float32 weights are now."""
        if self.working is not self.online:
            torch._foreach_copy_(self._working_parameters, self._parameters)

    @torch.no_grad()
    def _clip_gradient(self) -> torch.Tensor:
        """Hand the gradient to the optimizer, no longer than allowed; return its norm before."""
        gradients = [parameter.grad for parameter in self._working_parameters]
        if self.working is not self.online:
            for parameter in self._parameters:
                if parameter.grad is None:
                    parameter.grad = torch.empty_like(parameter)
            wide = [parameter.grad for parameter in self._parameters]
            torch._foreach_copy_(wide, gradients)
            gradients = wide
        norms = torch._foreach_norm(gradients)
        if self.settings.pixel_range != 1:
            # of the layer of wider pixels
            norms = [norms[0] * self.settings.pixel_range, *norms[1:]]
        norm = torch.stack(norms).norm()
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

    def begin_with(self, tensors: dict[str, torch.Tensor]) -> None:
        """Take over weights that acted, as `acting_tensors` gave them, in every network."""
        for network in self._networks().values():
            network.load_state_dict(tensors)
        self._copy_to_working()

    def _explain(self, batch: Batch, result: dict[str, float]) -> str:
        """Return where a loss that is not finite comes from."""
        parts = [f'update {self.updates + 1}: the loss is {result["loss"]}, the norm of the '
                 f'gradient {result["grad_norm"]}']
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
        return self.dropout.bit_generator.state

    @random_state.setter
    def random_state(self, state: dict[str, Any]) -> None:
        self.dropout.bit_generator.state = state

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
            ValueError: a tensor has another shape or type.
        """
        def taken(name: str, like: torch.Tensor) -> torch.Tensor:
            tensor = tensors[name]
            if tensor.shape != like.shape or tensor.dtype != torch.float32:
                raise ValueError(f'{name} is {tensor.dtype} {tuple(tensor.shape)}; expected '
                                 f'torch.float32 {tuple(like.shape)}')
            return tensor

        for what, network in self._networks().items():
            network.load_state_dict({
                name: taken(f'{what}.{name}', own) for name, own in network.state_dict().items()})
        self._optimizer.state.clear()
        for name, parameter in self.online.named_parameters() if updates else ():
            # the fused kernel reads memory as it lies: the layout must be the weights' own
            self._optimizer.state[parameter] = {
                'step': taken(f'adam.step.{name}', torch.empty(())).to(self.device).clone(),
                **{key: torch.empty_like(parameter, requires_grad=False).copy_(
                    taken(f'adam.{key}.{name}', parameter)) for key in ('exp_avg', 'exp_avg_sq')}}
        self._copy_to_working()
        self.updates = updates

    def _networks(self) -> dict[str, QNetwork]:
        networks = {'online': self.online, 'target': self.target}
        if self.averaged is not None:
            networks['averaged'] = self.averaged
        return networks
