# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The Q-network, built from its description."""
from __future__ import annotations

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from dqn_policy_node.model_description import ModelDescription

# the convolution whose outputs are dropped, counted from 0 (AMD-RIPS/RL-2018: conv2)
DROPOUT_LAYER = 1


class QNetwork(nn.Module):
    """
    Convolutions, one fully connected layer and a Q-value for each action (report, 2.1).

    With `quantiles` in its description the last layer gives that many quantiles of the return of
    each action (arXiv 1710.10044), and a Q-value is their mean.

    Everything lies channels-last, in which the CPU's convolutions are fastest; the fully
    connected layer takes its inputs in that order, too, so nothing is moved in between.
    """

    def __init__(self, description: ModelDescription) -> None:
        """Make the layers with PyTorch's usual random start."""
        super().__init__()
        network = description.network
        self.description = description
        inputs = [description.frame_stack] + [layer.filters for layer in network.convolutions]
        self.convolutions = nn.ModuleList(
            nn.Conv2d(channels, layer.filters, layer.kernel, layer.stride)
            for channels, layer in zip(inputs, network.convolutions))
        channels, height, width = description.features
        actions = len(description.action_space)
        self.hidden = nn.Linear(channels * height * width, network.hidden)
        if network.dueling:
            self.value = nn.Linear(network.hidden // 2, network.quantiles)
            self.advantage = nn.Linear(network.hidden // 2, actions * network.quantiles)
        else:
            self.output = nn.Linear(network.hidden, actions * network.quantiles)
        self._quantiles = network.quantiles
        self.dropout = network.dropout
        self.to(memory_format=torch.channels_last)

    def prepare(self, observations: torch.Tensor) -> torch.Tensor:
        """Return observations, uint8 (B, stack, H, W), as `forward` takes them: 0 to 255."""
        # bytes are moved before they get wider; bfloat16 holds whole numbers up to 256 exactly
        observations = observations.contiguous(memory_format=torch.channels_last)
        return observations.to(self.hidden.weight.dtype)

    def forward(
        self, x: torch.Tensor, *, dropout: np.random.Generator | None = None,
    ) -> torch.Tensor:
        """
        Return the Q-values.

        Args:
            x: what `prepare` returned, (B, stack, H, W).
            dropout: generator that chooses activations to drop, as while learning.

        Returns:
            float32 (B, actions), whatever the weights are.
        """
        outputs = self._outputs(x, dropout)
        return outputs if self._quantiles == 1 else outputs.mean(2)

    def quantiles(
        self, x: torch.Tensor, *, dropout: np.random.Generator | None = None,
    ) -> torch.Tensor:
        """Return the quantiles, float32 (B, actions, quantiles); arguments as for `forward`."""
        outputs = self._outputs(x, dropout)
        return outputs.unsqueeze(2) if self._quantiles == 1 else outputs

    def _outputs(self, x: torch.Tensor, dropout: np.random.Generator | None) -> torch.Tensor:
        """Return what the last layer gives: (B, actions), or (B, actions, quantiles)."""
        for index, layer in enumerate(self.convolutions):
            # observations are scaled to 0..1 by way of the weights, which are fewer
            weight = layer.weight * (1 / 255) if index == 0 else layer.weight
            x = functional.relu(
                functional.conv2d(x, weight, layer.bias, layer.stride), inplace=True)
            if dropout is not None and self.dropout and index == DROPOUT_LAYER:
                x = x * _dropout_mask(x, self.dropout, dropout)
        x = functional.relu(self.hidden(x.permute(0, 2, 3, 1).flatten(1)), inplace=True)
        x = x.float()
        if not self.description.network.dueling:
            return self._by_action(self.output(x))
        of_value, of_advantage = x.chunk(2, dim=1)
        value, advantage = self.value(of_value), self._by_action(self.advantage(of_advantage))
        if self._quantiles > 1:
            value = value.unsqueeze(1)
        return value + advantage - advantage.mean(1, keepdim=True)

    def _by_action(self, x: torch.Tensor) -> torch.Tensor:
        return x if self._quantiles == 1 else x.unflatten(1, (-1, self._quantiles))

    def to_bfloat16(self) -> QNetwork:
        """
        Make the weights bfloat16, except those of the Q-values; return self.

        A Q-value of 20 has steps of 1/8 in bfloat16, which is more than actions differ by.
        """
        self.convolutions.to(torch.bfloat16)
        self.hidden.to(torch.bfloat16)
        return self


def _dropout_mask(x: torch.Tensor, share: float, random: np.random.Generator) -> torch.Tensor:
    """
    Return 0 for a share of the places of x and 1 / (1 - share) for the others.

    A byte a place from NumPy, so the share is met to 1/256; PyTorch's own dropout draws a float
    a place, one after the other, and costs more than the convolution before it.
    """
    batch, channels, height, width = x.shape
    draws = random.integers(0, 256, (batch, height, width, channels), np.uint8)
    least = round(share * 256)
    kept = torch.from_numpy(draws).to(x.device).ge(least).to(x.dtype)
    return kept.mul_(256 / (256 - least)).permute(0, 3, 1, 2)
