# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantile regression: the distribution of the return in place of its mean (arXiv 1710.10044).

The network gives N quantiles of the return of each action; what is best is what has the highest
mean, so a policy acts by it as by any Q-network.
"""
from __future__ import annotations

import torch

from trainer_node.hyperparameters import Hyperparameters
from trainer_node.replay_buffer import Batch
from trainer_node.value_learner import ValueLearner


class QrDqnLearner(ValueLearner):
    """Learns quantiles of the return of each action: QR-DQN-0 by `l1`, QR-DQN-1 by `huber`."""

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Make the networks with random weights from PyTorch's generator."""
        super().__init__(settings, device)
        count = settings.quantiles
        # the middle of each of N equal shares of probability (lemma 2)
        self._shares = (torch.arange(count, device=self.device) + 0.5) / count

    def _loss(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        target = self._targets(batch)
        quantiles = self.working.quantiles(
            self.working.prepare(batch.observations), dropout=self.dropout)
        chosen = self.actions.of(quantiles, batch.actions)
        # every target sample against every quantile (algorithm 1): (B, targets, quantiles)
        error = target.unsqueeze(2) - chosen.unsqueeze(1)
        weight = (self._shares - (error.detach() < 0).float()).abs()
        loss = (weight * self.loss_of(error)).mean(1).sum(1).mean()
        loss = loss + self._margin_loss(quantiles.mean(2), batch)
        mean = chosen.mean(1)
        return loss, (mean - target.mean(1)).abs().mean(), mean.mean()

    @torch.no_grad()
    def _targets(self, batch: Batch) -> torch.Tensor:
        """Return reward plus discounted quantiles of what came next, float32 (B, quantiles)."""
        following = self.target.prepare(batch.next_observations)
        judged = self.target.quantiles(following)
        chooser = self.working(following) if self.settings.double else judged.mean(2)
        best = self.actions.of(judged, self.actions.best(chooser))
        return batch.rewards.unsqueeze(1) + batch.discounts.unsqueeze(1) * best
