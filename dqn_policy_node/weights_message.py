# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The `weights` topic: a safetensors image with version, epsilon, description and hash."""
from __future__ import annotations

from collections import deque
import dataclasses
import json
import math
from typing import Any

import torch

from dqn_policy_node.action_space import has_two_parts
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import json_sha256, ModelDescription
from dqn_policy_node.safetensors_image import pack, read_metadata, tensors_sha256, unpack

FORMAT = 'carracing_dqn weights 2'
# of version 0.1, in bags: the description has another form
READABLE = ('carracing_dqn weights 1', FORMAT)
METADATA_KEY = 'carracing_dqn'
MAX_HOLD = 1000
# among the extra values: share of the training episodes that are driven with the axes of the space
AXES_SHARE = 'axes_share'
MAX_SESSION = 100
# of trainers that are remembered
SESSIONS = 100


@dataclasses.dataclass(frozen=True)
class WeightsUpdate:
    """
    Weights of one version and how to act with them.

    Attributes:
        tensors: name -> float32 weights.
        description: the model they belong to.
        version: number of the version, rising.
        epsilon: share of random actions, 0 to 1.
        gas_weight: how much likelier than others a random action is one with gas.
        exploration_hold: most decisions for which a random action is held.
        validate: whether the trainer asks for a validation of this version.
        session: what the trainer calls this start of its; versions rise within one. Empty in
            images of before the field.
        extra: further values that the trainer wanted to hand on.
    """

    tensors: dict[str, torch.Tensor]
    description: ModelDescription
    version: int
    epsilon: float = 0.0
    gas_weight: float = 1.0
    exploration_hold: int = 1
    validate: bool = False
    extra: dict[str, Any] = dataclasses.field(default_factory=dict)
    session: str = ''

    @property
    def axes_share(self) -> float | None:
        """Return the share of episodes to drive with the axes; None: choose from everything."""
        return self.extra.get(AXES_SHARE)


def encode_weights(
    tensors: dict[str, torch.Tensor],
    description: ModelDescription,
    *,
    version: int,
    epsilon: float = 0.0,
    gas_weight: float = 1.0,
    exploration_hold: int = 1,
    validate: bool = False,
    extra: dict[str, Any] | None = None,
    session: str = '',
) -> bytes:
    """Return the bytes to publish; `WeightsUpdate` describes the values."""
    record = {
        'format': FORMAT,
        'version': version, 'epsilon': epsilon, 'gas_weight': gas_weight,
        'exploration_hold': exploration_hold, 'validate': validate, 'extra': extra or {},
        'session': session,
        'description': description.to_json(),
        'description_sha256': description.sha256(),
        'sha256': tensors_sha256(tensors),
    }
    # one entry, because safetensors writes several in no fixed order
    return pack(tensors, {METADATA_KEY: json.dumps(record)})


def _read_record(data: bytes) -> tuple[dict[str, Any], ModelDescription]:
    """Return the values of a weights image and the description in it; raises ModelError."""
    metadata = read_metadata(data)
    try:
        record = json.loads(metadata.get(METADATA_KEY, '{}'))
    except (ValueError, TypeError, RecursionError):
        record = None
    if not isinstance(record, dict) or record.get('format') not in READABLE:
        raise ModelError(f'weights image is not a {FORMAT!r}')
    description = ModelDescription.from_json(record.get('description'))
    if record.get('description_sha256') != json_sha256(record.get('description')):
        raise ModelError('weights image is damaged: its description does not match its hash')
    return record, description


def is_marked(data: bytes) -> bool:
    """Return whether a weights image asks for a validation, weights unread; raises ModelError."""
    return _read_record(data)[0].get('validate') is True


def read_extra(data: bytes) -> dict[str, Any]:
    """Return the further values of a weights image, weights unread; raises ModelError."""
    extra = _read_record(data)[0].get('extra')
    if not isinstance(extra, dict):
        raise ModelError('weights image with values of the wrong type')
    return extra


def decode_weights(data: bytes, description: ModelDescription | None = None) -> WeightsUpdate:
    """
    Check and read a weights image.

    Args:
        data: what came over the topic.
        description: the model it has to be for; None takes the one it brings.

    Raises:
        ModelError: the image is damaged, for another model, or its values are not accepted.
    """
    record, own = _read_record(data)
    if description is not None and own != description:
        raise ModelError(f'weights are for another model: {own.differences(description)[0]}')
    tensors = unpack(data, own)
    if tensors_sha256(tensors) != record.get('sha256'):
        raise ModelError('weights image is damaged: its hash does not match its weights')
    try:
        version, validate, extra = record['version'], record['validate'], record['extra']
        epsilon, gas_weight = float(record['epsilon']), float(record['gas_weight'])
        # images of before the field have none
        hold = record.get('exploration_hold', 1)
        session = record.get('session', '')
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise ModelError(f'weights image without readable values: {error}') from None
    if type(version) is not int or not 0 <= version < 2**53:
        raise ModelError(f'weights version {version!r}; accepted: whole numbers from 0')
    if not 0 <= epsilon <= 1:
        raise ModelError(f'weights epsilon {epsilon!r}; accepted: 0 to 1')
    if not (math.isfinite(gas_weight) and 0 < gas_weight <= 1000):
        raise ModelError(f'weights gas_weight {gas_weight!r}; accepted: above 0, up to 1000')
    if type(hold) is not int or not 1 <= hold <= MAX_HOLD:
        raise ModelError(f'weights exploration_hold {hold!r}; accepted: 1 to {MAX_HOLD}')
    if type(validate) is not bool or not isinstance(extra, dict) or not (
            isinstance(session, str) and len(session) <= MAX_SESSION):
        raise ModelError('weights image with values of the wrong type')
    share = extra.get(AXES_SHARE)
    if share is not None and not (
            has_two_parts(own.action_space) and type(share) in (int, float) and 0 <= share <= 1):
        raise ModelError(f'weights {AXES_SHARE} {str(share)[:40]!r}; accepted: 0 to 1, for a '
                         'space that has both single commands and axes')
    return WeightsUpdate(
        tensors, own, version, epsilon, gas_weight, hold, validate, extra, session)


class NewestWeights:
    """Tells newer weights from what an earlier moment, or an earlier trainer, has left."""

    def __init__(self) -> None:
        """Start without any."""
        self._version = -1
        # in the order in which they came; the last one is at work
        self._sessions: deque[str] = deque(maxlen=SESSIONS)

    def check(self, update: WeightsUpdate) -> None:
        """
        Take note of weights, whose versions rise within a session of a trainer.

        Raises:
            ModelError: they are older than those before.
        """
        if self._sessions and update.session == self._sessions[-1]:
            if update.version < self._version:
                raise ModelError(f'weights version {update.version} is older than '
                                 f'{self._version}, which is at work')
        elif update.session in self._sessions:
            raise ModelError(f'weights version {update.version} is of an earlier start of a '
                             'trainer than the one at work')
        else:
            self._sessions.append(update.session)
        self._version = update.version
