# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`model.json`: what is told of a model beside its weights, read without torch."""
from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import json_sha256, ModelDescription
from msgs_bridge.regular_file import read_regular
from msgs_bridge.step import MAX_WHOLE

WEIGHTS_FILE = 'weights.safetensors'
MODEL_FILE = 'model.json'
FORMAT = 'carracing_dqn model 2'
# of version 0.1: the description has another form
READABLE = ('carracing_dqn model 1', FORMAT)
MAX_MODEL_FILE_BYTES = 4 * 2**20
# of an error about what a file says, so that it stays a line
MAX_TEXT = 200


@dataclasses.dataclass(frozen=True)
class ModelRecord:
    """
    What stands in `model.json`.

    Attributes:
        description: everything but the weights.
        training: the record of how the model came about, JSON values.
        version: version of its weights.
        weights_sha256: hash of the file of the weights.
    """

    description: ModelDescription
    training: dict[str, Any]
    version: int
    weights_sha256: str


def model_json(
    description: ModelDescription, training: dict[str, Any], version: int, weights_sha256: str,
) -> str:
    """Return the text of `model.json`."""
    record = {
        'format': FORMAT,
        'version': version,
        'description': description.to_json(),
        'description_sha256': description.sha256(),
        'sha256': {WEIGHTS_FILE: weights_sha256},
        'training': training,
    }
    # of everything else in the file
    record['record_sha256'] = json_sha256(record)
    return json.dumps(record, indent=1) + '\n'


def read_model_record(folder: Path | str) -> ModelRecord:
    """
    Read `model.json` of a model folder; the weights are not looked at.

    Raises:
        ModelError: it is missing or damaged, or its values are not accepted; the text names it.
    """
    path = Path(folder) / MODEL_FILE
    text = read_regular(path, MAX_MODEL_FILE_BYTES, ModelError)
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
        if version > MAX_WHOLE:
            raise ModelError(f'version has more than {len(str(MAX_WHOLE))} digits')
        if record['description_sha256'] != json_sha256(record['description']):
            raise ModelError('description does not match its hash')
    except ModelError as error:
        raise ModelError(f'{path}: {str(error)[:MAX_TEXT]}') from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(f'{path}: {type(error).__name__} {str(error)[:MAX_TEXT]}') from None
    return ModelRecord(description, training, version, hash_of_weights)
