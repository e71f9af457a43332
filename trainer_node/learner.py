# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a run asks of a learning algorithm, and the algorithms there are.

A new one is a module with a class that has these methods, and a line in `LEARNERS`
(docs/extending.md). Nothing here imports torch, so that settings can name the learners without it.
"""
from __future__ import annotations

import dataclasses
import importlib
from typing import Any, ClassVar, Protocol, TYPE_CHECKING

if TYPE_CHECKING:
    from torch import device, Tensor
    from trainer_node.hyperparameters import Hyperparameters
    from trainer_node.replay_buffer import Batch


class Learner(Protocol):
    """
    Networks, optimizer and update of one algorithm; made with (settings, device).

    Everything it does must follow from its state, so that a run that is resumed learns the same.

    Attributes:
        FIGURES: names of what `update` returns; they become columns of `updates.csv`. `loss`,
            `td_error`, `q_mean` and `grad_norm` are shown by the displays, too.
        device: where it computes.
        updates: updates made.
        random_state: state of its own random generators, JSON values; may be set.
    """

    FIGURES: ClassVar[tuple[str, ...]]
    device: device
    updates: int
    random_state: dict[str, Any]

    def __init__(self, settings: Hyperparameters, device: str = 'auto') -> None:
        """Make the networks with random weights; raises LearningError without the device."""

    def update(self, batch: Batch, learning_rate: float) -> dict[str, float]:
        """
        Make one update and return its figures.

        Raises:
            LearningError: the loss is not finite; the weights are as before the update.
        """

    def episode_ended(self, episodes: int) -> None:
        """Take note that so many training episodes have ended."""

    def acting_tensors(self) -> dict[str, Tensor]:
        """Return a copy of the weights that act and are validated, as the model names them."""

    def begin_with(self, tensors: dict[str, Tensor]) -> None:
        """Take over weights that `acting_tensors` gave, to learn on from them."""

    def state_tensors(self) -> dict[str, Tensor]:
        """Return every tensor that the next update depends on by name, on the CPU."""

    def load_state(self, tensors: dict[str, Tensor], updates: int) -> None:
        """Take over what `state_tensors` gave; KeyError, RuntimeError if it does not fit."""


@dataclasses.dataclass(frozen=True)
class LearnerEntry:
    """
    Where a learner is found.

    Attributes:
        place: `module:class`.
        quantiles: whether its network gives quantiles of the return instead of one value.
        margin: whether its loss keeps demonstrated actions above the others by a margin.
    """

    place: str
    quantiles: bool = False
    margin: bool = False


LEARNERS = {
    'dqn': LearnerEntry('trainer_node.dqn:DqnLearner', margin=True),
    'qr_dqn': LearnerEntry('trainer_node.qr_dqn:QrDqnLearner', quantiles=True, margin=True),
}


def make_learner(settings: Hyperparameters, device: str = 'auto') -> Learner:
    """Return the learner that settings name; raises LearningError if the device is not there."""
    module, _, name = LEARNERS[settings.learner].place.partition(':')
    return getattr(importlib.import_module(module), name)(settings, device)
