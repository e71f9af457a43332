# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A model on disk: a folder with `weights.safetensors` and `model.json`.

`model.json` holds the description, the training record, the hash of the weights file and one of
itself. A folder is written whole under another name and then put in place, never a pickle.
"""
from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import torch

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import json_sha256, ModelDescription
from dqn_policy_node.safetensors_image import MAX_BYTES, pack, unpack
from msgs_bridge.atomic_write import atomic_folder, write_bytes, write_text
from msgs_bridge.regular_file import read_regular

WEIGHTS_FILE = 'weights.safetensors'
MODEL_FILE = 'model.json'
FORMAT = 'carracing_dqn model 2'
# of version 0.1: the description has another form
READABLE = ('carracing_dqn model 1', FORMAT)
MAX_MODEL_FILE_BYTES = 4 * 2**20
# of an error about what a file says, so that it stays a line
MAX_TEXT = 200


@dataclasses.dataclass(frozen=True)
class Model:
    """
    A model as it lies in a folder.

    Attributes:
        description: everything but the weights.
        tensors: name -> float32 weights.
        training: the record of how it came about, JSON values.
        version: version of its weights.
    """

    description: ModelDescription
    tensors: dict[str, torch.Tensor]
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    version: int = 0


def save_model(folder: Path | str, model: Model) -> None:
    """
    Write a model folder, or replace one, whole or not at all.

    Raises:
        ModelError: the place is taken by something that is no model.
        OSError: the place cannot be written or the disk is full; an old folder stays.
    """
    folder = Path(folder)
    if folder.exists() and not (folder / MODEL_FILE).is_file() and (
            not folder.is_dir() or any(folder.iterdir())):
        raise ModelError(f'{folder} is there and is no model folder; it is left alone')
    folder.parent.mkdir(parents=True, exist_ok=True)
    weights = pack(model.tensors, {'format': FORMAT})
    record = {
        'format': FORMAT,
        'version': model.version,
        'description': model.description.to_json(),
        'description_sha256': model.description.sha256(),
        'sha256': {WEIGHTS_FILE: hashlib.sha256(weights).hexdigest()},
        'training': model.training,
    }
    # of everything else in the file
    record['record_sha256'] = json_sha256(record)
    with atomic_folder(folder) as new:
        write_bytes(new / WEIGHTS_FILE, weights)
        write_text(new / MODEL_FILE, json.dumps(record, indent=1) + '\n')


def load_model(folder: Path | str) -> Model:
    """
    Read a model folder.

    Raises:
        ModelError: a file is missing or damaged, or the values are not accepted; the text names
            the file.
    """
    folder = Path(folder)
    text = read_regular(folder / MODEL_FILE, MAX_MODEL_FILE_BYTES, ModelError)
    try:
        record = json.loads(text)
        if not isinstance(record, dict) or record.get('format') not in READABLE:
            raise ModelError(f'format is not {FORMAT!r}')
        own_hash = record.pop('record_sha256', None)
        # folders of version 0.1 have none
        if (own_hash is not None or record['format'] == FORMAT) and (
                own_hash != json_sha256(record)):
            raise ModelError('damaged, it does not match its hash')
        description = ModelDescription.from_json(record['description'])
        hash_of_weights = record['sha256'][WEIGHTS_FILE]
        training, version = record['training'], record['version']
        if not isinstance(training, dict) or type(version) is not int or version < 0:
            raise ModelError('training or version is of the wrong type')
        if record['description_sha256'] != json_sha256(record['description']):
            raise ModelError('description does not match its hash')
    except ModelError as error:
        raise ModelError(f'{folder / MODEL_FILE}: {str(error)[:MAX_TEXT]}') from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(
            f'{folder / MODEL_FILE}: {type(error).__name__} {str(error)[:MAX_TEXT]}') from None
    weights = read_regular(folder / WEIGHTS_FILE, MAX_BYTES, ModelError)
    if hashlib.sha256(weights).hexdigest() != hash_of_weights:
        raise ModelError(f'{folder / WEIGHTS_FILE}: damaged, its hash is not the one in '
                         f'{MODEL_FILE}')
    try:
        tensors = unpack(weights, description)
    except ModelError as error:
        raise ModelError(f'{folder / WEIGHTS_FILE}: {str(error)[:MAX_TEXT]}') from None
    return Model(description, tensors, training, version)
