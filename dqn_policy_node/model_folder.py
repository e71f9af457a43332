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
from pathlib import Path
from typing import Any

import torch

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import ModelDescription
from dqn_policy_node.model_record import (
    FORMAT, MAX_TEXT, MODEL_FILE, model_json, read_model_record, WEIGHTS_FILE,
)
from dqn_policy_node.safetensors_image import MAX_BYTES, pack, unpack
from msgs_bridge.atomic_write import atomic_folder, write_bytes, write_text
from msgs_bridge.regular_file import read_regular


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
    record = model_json(
        model.description, model.training, model.version, hashlib.sha256(weights).hexdigest())
    with atomic_folder(folder) as new:
        write_bytes(new / WEIGHTS_FILE, weights)
        write_text(new / MODEL_FILE, record)


def load_model(folder: Path | str) -> Model:
    """
    Read a model folder.

    Raises:
        ModelError: a file is missing or damaged, or the values are not accepted; the text names
            the file.
    """
    folder = Path(folder)
    record = read_model_record(folder)
    weights = read_regular(folder / WEIGHTS_FILE, MAX_BYTES, ModelError)
    if hashlib.sha256(weights).hexdigest() != record.weights_sha256:
        raise ModelError(f'{folder / WEIGHTS_FILE}: damaged, its hash is not the one in '
                         f'{MODEL_FILE}')
    try:
        tensors = unpack(weights, record.description)
    except ModelError as error:
        raise ModelError(f'{folder / WEIGHTS_FILE}: {str(error)[:MAX_TEXT]}') from None
    return Model(record.description, tensors, record.training, record.version)
