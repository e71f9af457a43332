# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Deep Q-learning: target and loss (Nature 518, 529; the report, 2.2.1)."""
from __future__ import annotations

import torch

from trainer_node.replay_buffer import Batch
from trainer_node.value_learner import ValueLearner


class DqnLearner(ValueLearner):
    """Learns the value of each action; Double with `double` (arXiv 1509.06461)."""

    def _loss(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        target = self._targets(batch)
        q_values = self.working(
            self.working.prepare(batch.observations), dropout=self.dropout)
        chosen = self.actions.of(q_values, batch.actions)
        error = chosen - target
        loss = self.loss_of(error).mean() + self._margin_loss(q_values, batch)
        return loss, error.abs().mean(), chosen.mean()

    @torch.no_grad()
    def _targets(self, batch: Batch) -> torch.Tensor:
        """Return reward plus discounted value of what came next, float32 (B,)."""
        following = self.target.prepare(batch.next_observations)
        judged = self.target(following)
        if self.settings.double:
            value = self.actions.of(judged, self.actions.best(self.working(following)))
        else:
            value = self.actions.highest(judged)
        return batch.rewards + batch.discounts * value
