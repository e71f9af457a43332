# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Versions of the weights: when they go out, which are validated, and which are the best.

A result comes back long after its weights went out, so what is known of the moment at which they
were made is kept with them until then.
"""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math

import numpy as np
import torch

from msgs_bridge.errors import MessageError
from msgs_bridge.step import MAX_REWARD, MAX_WHOLE, VALIDATION_FIELDS
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.saved_state import is_finite, Seconds

# versions sent out for validation whose results have not come back
MAX_PENDING = 4
# what a result may be; who says more has measured nothing
_ACCEPTED = {
    'version': (0, MAX_WHOLE), 'episodes': (1, MAX_WHOLE), 'std': (0, MAX_REWARD),
    'completed': (0, 1), 'seconds': (0, MAX_WHOLE),
    **dict.fromkeys(('mean', 'minimum', 'maximum'), (-MAX_REWARD, MAX_REWARD))}


@dataclasses.dataclass(frozen=True)
class Moment:
    """How far a run is: what weights were made after."""

    episode: int
    decisions: int
    updates: int
    wall_seconds: Seconds


# of the row of a validation
_ROW = {*VALIDATION_FIELDS, *(field.name for field in dataclasses.fields(Moment))}


@dataclasses.dataclass(frozen=True)
class Judgement:
    """
    What a validation said.

    Attributes:
        row: its figures, and the moment its weights were made.
        tensors: those weights.
        better: whether no weights before were as good.
    """

    row: dict[str, float]
    tensors: dict[str, torch.Tensor]
    better: bool


@dataclasses.dataclass(frozen=True)
class SelectionState:
    """What `ModelSelection` is, apart from the weights that are being validated."""

    version: int
    published_updates: int
    published_epsilon: float | None
    validate: bool
    validation_decisions: int
    validation_seconds: Seconds
    best: dict[str, float]
    last: dict[str, float]
    pending: dict[str, Moment]


class ModelSelection:
    """
    Decides when weights go out and when they are validated, and remembers the best.

    Attributes:
        State: what `state` returns.
        version: version of the weights that went out last, 0 before the first.
        epsilon: that of the weights that went out last, None before the first.
        best, last: row of the best and of the last validation, empty before the first.
    """

    State = SelectionState

    def __init__(self, settings: Hyperparameters) -> None:
        """Begin before the first version."""
        self._settings = settings
        self.version = 0
        self.epsilon: float | None = None
        self.best: dict[str, float] = {}
        self.last: dict[str, float] = {}
        self._published_updates = 0
        self._validate = False
        self._validation_decisions = 0
        self._validation_seconds = 0.0
        self._pending: dict[int, tuple[Moment, dict[str, torch.Tensor]]] = {}

    def ask_when_due(self, moment: Moment, *, episode_ended: bool) -> None:
        """Ask for a validation of the next version when enough has happened since the last."""
        settings = self._settings
        due = bool(episode_ended and settings.validation_every_episodes
                   and moment.episode % settings.validation_every_episodes == 0)
        every = settings.validation_every_decisions
        due |= bool(every and moment.decisions - self._validation_decisions >= every)
        every = settings.validation_every_minutes * 60
        due |= bool(every and moment.wall_seconds - self._validation_seconds >= every)
        if due:
            self._validate = True
            self._validation_decisions = moment.decisions
            self._validation_seconds = moment.wall_seconds

    def due(self, updates: int, epsilon: float) -> bool:
        """
        Return whether weights should go out now.

        An epsilon that falls by the episode goes out with every one of its values, so that
        each episode is driven with its own.
        """
        return (self.version == 0 or self._validate
                or updates - self._published_updates >= self._settings.weights_every
                or (self._settings.epsilon_schedule == 'episodes' and epsilon != self.epsilon))

    def next_version(
        self, tensors: dict[str, torch.Tensor], moment: Moment, epsilon: float, *,
        validate: bool | None,
    ) -> bool:
        """
        Take note of weights that go out as the next version; return whether to validate them.

        Args:
            tensors: the weights, which nobody changes any more.
            moment: when they were made.
            epsilon: what goes out with them.
            validate: whether to; None leaves it to the schedule.
        """
        if validate is None:
            validate = self._validate
        self.version += 1
        self.epsilon = epsilon
        self._published_updates = moment.updates
        if validate:
            self._validate = False
            self._pending[self.version] = moment, tensors
            while len(self._pending) > MAX_PENDING:
                del self._pending[min(self._pending)]
        return validate

    def judge(self, values: Mapping[str, float]) -> Judgement | None:
        """
        Take the result of a validation.

        Args:
            values: `step.VALIDATION_FIELDS`.

        Returns:
            What it says; None for a version that was not asked for, or was answered already.

        Raises:
            MessageError: a field is missing, or no result can have it; the version is still
                waited for.
        """
        for name in VALIDATION_FIELDS:
            if name not in values or not math.isfinite(values[name]):
                raise MessageError(f'validation lacks {name!r} or it is not finite')
            low, high = _ACCEPTED[name]
            if not low <= values[name] <= high:
                raise MessageError(
                    f'{name} of a validation is {values[name]:g}; accepted: {low:g} to {high:g}')
        found = self._pending.pop(values['version'], None)
        if found is None:
            return None
        moment, tensors = found
        self.last = {
            **{name: values[name] for name in VALIDATION_FIELDS}, **dataclasses.asdict(moment)}
        score = self._score(values)
        better = not self.best or score > self.best['score']
        if better:
            self.best = {'score': score, **self.last}
        return Judgement(self.last, tensors, better)

    def _score(self, values: Mapping[str, float]) -> float:
        return values['mean'] - self._settings.validation_spread_weight * values['std']

    def best_is(self, row: object) -> None:
        """
        Take note of what lies in `best/`, whatever the checkpoint says of it.

        A session that was killed may have put it there after its last checkpoint, one that could
        not write may have left a worse one, and somebody may have removed it.

        Args:
            row: the `best` of the session that has written it; None where there is no model. Of
                one that does not say, the checkpoint is believed.
        """
        if row is None:
            self.best = {}
        elif isinstance(row, dict) and row.keys() == _ROW | {'score'} and all(
                map(is_finite, row.values())):
            self.best = {**row, 'score': self._score(row)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the weights that are being validated."""
        return {f'{version}.{name}': tensor.contiguous().numpy()
                for version, (_, tensors) in self._pending.items()
                for name, tensor in tensors.items()}

    def state(self) -> SelectionState:
        """Return the rest of it."""
        return SelectionState(
            self.version, self._published_updates, self.epsilon, self._validate,
            self._validation_decisions, self._validation_seconds, self.best, self.last,
            {str(version): moment for version, (moment, _) in self._pending.items()})

    def restore(self, state: SelectionState, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a checkpoint; KeyError or ValueError if it does not fit."""
        self.version, self.epsilon = state.version, state.published_epsilon
        self._published_updates = state.published_updates
        self._validation_decisions = state.validation_decisions
        self._validation_seconds = state.validation_seconds
        self.best, self.last = state.best, state.last
        for row, figures in ((self.best, _ROW | {'score'}), (self.last, _ROW)):
            if row and row.keys() != figures:
                raise ValueError('its validations lack a figure')
        if self.best:
            # by the weight of the spread that holds now
            self.best = {**self.best, 'score': self._score(self.best)}
        self._pending = {int(version): (moment, {}) for version, moment in state.pending.items()}
        for key, array in arrays.items():
            version, _, name = key.partition('.')
            self._pending[int(version)][1][name] = torch.from_numpy(array)
        shapes = self._settings.model_description().shapes
        for version, (_, tensors) in self._pending.items():
            if {name: tuple(tensor.shape) for name, tensor in tensors.items()
                    if tensor.dtype == torch.float32} != shapes:
                raise ValueError(f'weights of version {version} are not of the model')
        # nobody drives what was out for validation any more: the next version is asked for
        self._validate = state.validate or bool(self._pending)
