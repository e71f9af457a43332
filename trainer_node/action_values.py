# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Values of encoded actions, in batches, out of a network's outputs.

For each kind of action space: what an action is worth, and which is the best. Both take outputs
with further dimensions behind those of batch and output, such as quantiles.
"""
from __future__ import annotations

from typing import Protocol

import torch

from dqn_policy_node.action_space import ActionSpace
from dqn_policy_node.axis_actions import Hybrid, NONE


class ActionValues(Protocol):
    """Where the value of an action is found."""

    def of(self, outputs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return what actions, encoded (B, ...), are worth: (B, ...) of outputs (B, O, ...)."""

    def best(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the encoded action of the highest value for each of outputs (B, O)."""

    def highest(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the value of it, (B,), of outputs (B, O)."""

    def apart(self, actions: torch.Tensor, outputs: int) -> torch.Tensor:
        """
        Return how far each output is from actions, encoded (B, ...): (B, O), 0 to 1.

        0 is the action's own, 1 another altogether.
        """


class OutputValues:
    """An action is an output: a table of commands."""

    def of(self, outputs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return the outputs of indices (B,)."""
        index = actions.long().view(-1, 1, *(1 for _ in outputs.shape[2:]))
        return outputs.gather(1, index.expand(-1, 1, *outputs.shape[2:])).squeeze(1)

    def best(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the index of the highest output, (B,)."""
        return outputs.argmax(1)

    def highest(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the highest output, (B,)."""
        return outputs.amax(1)

    def apart(self, actions: torch.Tensor, outputs: int) -> torch.Tensor:
        """Return 0 for the index of an action, 1 for the others, float32 (B, O)."""
        places = torch.arange(outputs, device=actions.device)
        return (places != actions.long().unsqueeze(1)).float()


class AxisValues:
    """An action is a place on each axis of a mode; its value is the mean of the axes'."""

    def __init__(self, space: Hybrid) -> None:
        """Take the layout of a space."""
        self._layout = space.layout

    def of(self, outputs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return values at places (B, 2): straight lines between nodes, mean over the axes."""
        behind = (1 for _ in outputs.shape[2:])
        places = actions.view(*actions.shape, *behind)
        there = places != NONE
        low = places.clamp(min=0).floor()
        share = (places - low) * there
        index = low.long().expand(-1, -1, *outputs.shape[2:])
        # the place of a last node lies on it alone
        beyond = (index + 1).clamp(max=outputs.shape[1] - 1)
        values = torch.lerp(outputs.gather(1, index), outputs.gather(1, beyond),
                            share.to(outputs.dtype).expand_as(index))
        return (values * there).sum(1) / there.sum(1)

    def best(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the places of the best mode at its best nodes, float32 (B, 2)."""
        values, places = [], []
        for axes in self._layout:
            highest = [outputs[:, axis].max(1) for axis in axes]
            values.append(torch.stack([each.values for each in highest]).mean(0))
            own = [each.indices.float() + axis.start for each, axis in zip(highest, axes)]
            own += [torch.full_like(own[0], NONE)] * (2 - len(own))
            places.append(torch.stack(own, 1))
        modes = torch.stack(values, 1).argmax(1)
        return torch.stack(places, 1)[torch.arange(len(modes), device=modes.device), modes]

    def highest(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return the value of the best mode at its best nodes, (B,)."""
        return torch.stack([
            torch.stack([outputs[:, axis].amax(1) for axis in axes]).mean(0)
            for axes in self._layout], 1).amax(1)

    def apart(self, actions: torch.Tensor, outputs: int) -> torch.Tensor:
        """Return the way along the axes of the action's mode, 1 from its next node on, (B, O)."""
        places = torch.arange(outputs, device=actions.device)
        apart = torch.ones((len(actions), outputs), device=actions.device)
        for axes in self._layout:
            own = (actions[:, 0] >= axes[0].start) & (actions[:, 0] <= axes[0].stop - 1)
            for number, axis in enumerate(axes):
                away = (places[axis] - actions[:, number].unsqueeze(1)).abs().clamp(max=1)
                apart[:, axis] = torch.where(own.unsqueeze(1), away, apart[:, axis])
        return apart


def action_values(space: ActionSpace) -> ActionValues:
    """Return what finds the values of a space's actions."""
    return AxisValues(space) if isinstance(space, Hybrid) else OutputValues()
