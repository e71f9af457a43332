# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The Q-network, built from its description."""
from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from dqn_policy_node.model_description import ModelDescription

# the convolution whose outputs are dropped, counted from 0 (AMD-RIPS/RL-2018: conv2)
DROPOUT_LAYER = 1


class QNetwork(nn.Module):
    """
    Convolutions, one fully connected layer and a Q-value for each action (report, 2.1).

    Weights are kept channels-last, in which the CPU's convolutions are fastest.
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
        actions = len(description.action_set)
        self.hidden = nn.Linear(channels * height * width, network.hidden)
        if network.dueling:
            self.value = nn.Linear(network.hidden // 2, 1)
            self.advantage = nn.Linear(network.hidden // 2, actions)
        else:
            self.output = nn.Linear(network.hidden, actions)
        self.dropout = network.dropout
        self.to(memory_format=torch.channels_last)

    def forward(self, pictures: torch.Tensor, *, dropout: bool = False) -> torch.Tensor:
        """
        Return the Q-values.

        Args:
            pictures: uint8 (B, stack, H, W), 0 to 255.
            dropout: whether to drop activations, as while learning.

        Returns:
            float32 (B, actions); bfloat16 arithmetic inside autocast gives float32 as well.
        """
        x = pictures.to(self.hidden.weight.dtype).mul_(1 / 255)
        x = x.contiguous(memory_format=torch.channels_last)
        for index, convolution in enumerate(self.convolutions):
            x = functional.relu(convolution(x), inplace=True)
            if dropout and self.dropout and index == DROPOUT_LAYER:
                x = functional.dropout(x, self.dropout)
        x = functional.relu(self.hidden(x.flatten(1)), inplace=True)
        if not self.description.network.dueling:
            return self.output(x).float()
        of_value, of_advantage = x.chunk(2, dim=1)
        advantage = self.advantage(of_advantage).float()
        return self.value(of_value).float() + advantage - advantage.mean(1, keepdim=True)
