# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A model on disk: a folder with `weights.safetensors` and `model.json`.

`model.json` holds the description, the training record and the hash of the weights file. A
folder is written whole under another name and then put in place, never a pickle.
"""
from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
import shutil
import tempfile
from typing import Any

import torch

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import json_sha256, ModelDescription
from dqn_policy_node.safetensors_image import MAX_BYTES, pack, unpack
from msgs_bridge.atomic_write import write_bytes, write_text

WEIGHTS_FILE = 'weights.safetensors'
MODEL_FILE = 'model.json'
FORMAT = 'carracing_dqn model 2'
# of version 0.1: the description has another form
READABLE = ('carracing_dqn model 1', FORMAT)
MAX_MODEL_FILE_BYTES = 4 * 2**20


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
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f'.{folder.name}.'))
    try:
        new, old = temporary / 'new', temporary / 'old'
        new.mkdir()
        write_bytes(new / WEIGHTS_FILE, weights)
        write_text(new / MODEL_FILE, json.dumps(record, indent=1) + '\n')
        if folder.exists():
            folder.rename(old)
        try:
            new.rename(folder)
        except OSError:
            if old.exists():
                old.rename(folder)
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def load_model(folder: Path | str) -> Model:
    """
    Read a model folder.

    Raises:
        ModelError: a file is missing or damaged, or the values are not accepted; the text names
            the file.
    """
    folder = Path(folder)
    text = _read(folder / MODEL_FILE, MAX_MODEL_FILE_BYTES)
    try:
        record = json.loads(text)
        if not isinstance(record, dict) or record.get('format') not in READABLE:
            raise ModelError(f'format is not {FORMAT!r}')
        description = ModelDescription.from_json(record['description'])
        hash_of_weights = record['sha256'][WEIGHTS_FILE]
        training, version = record['training'], record['version']
        if not isinstance(training, dict) or type(version) is not int or version < 0:
            raise ModelError('training or version is of the wrong type')
        if record['description_sha256'] != json_sha256(record['description']):
            raise ModelError('description does not match its hash')
    except ModelError as error:
        raise ModelError(f'{folder / MODEL_FILE}: {error}') from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(f'{folder / MODEL_FILE}: {type(error).__name__} {error}') from None
    weights = _read(folder / WEIGHTS_FILE, MAX_BYTES)
    if hashlib.sha256(weights).hexdigest() != hash_of_weights:
        raise ModelError(f'{folder / WEIGHTS_FILE}: damaged, its hash is not the one in '
                         f'{MODEL_FILE}')
    try:
        tensors = unpack(weights, description)
    except ModelError as error:
        raise ModelError(f'{folder / WEIGHTS_FILE}: {error}') from None
    return Model(description, tensors, training, version)


def _read(path: Path, limit: int) -> bytes:
    """Return the bytes of a file of at most `limit` bytes; raises ModelError."""
    try:
        if path.stat().st_size > limit:
            raise ModelError(f'{path}: longer than {limit} bytes')
        return path.read_bytes()
    except FileNotFoundError:
        raise ModelError(f'{path}: no such file') from None
    except OSError as error:
        raise ModelError(f'{path}: {error.strerror}') from None
