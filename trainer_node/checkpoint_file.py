# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One safetensors file with everything of a run, written whole or not at all, and its checksum."""
from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.regular_file import read_regular
from trainer_node.errors import RunError

FORMAT = 'carracing_dqn checkpoint 2'
MAX_BYTES = 4 * 2**30
# stands where the checksum will be while the bytes are summed up
_NO_SUM = b'0' * 64


def write_checkpoint(
    path: Path | str, arrays: dict[str, np.ndarray], state: dict[str, Any],
    format_name: str = FORMAT,
) -> None:
    """
    Write arrays and a JSON state; on any error the file that was there stays whole.

    Args:
        path: of the file.
        arrays: by name.
        state: JSON values.
        format_name: what the file is.

    Raises:
        OSError: the folder cannot be written or the disk is full.
    """
    record = json.dumps({'format': format_name, 'sha256': _NO_SUM.decode(), 'state': state})
    # one entry, because safetensors writes several in no fixed order
    data = safetensors.numpy.save(
        {name: np.asarray(array, order='C') for name, array in arrays.items()},
        {'checkpoint': record})
    place = data.index(_NO_SUM)
    digest = hashlib.sha256(data).hexdigest().encode()
    write_bytes(path, data[:place] + digest + data[place + len(digest):])


def read_checkpoint(
    path: Path | str, format_name: str = FORMAT,
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """
    Read what `write_checkpoint` wrote; every byte of it is checked.

    Raises:
        RunError: the file is missing, damaged or no checkpoint of this format.
    """
    path = Path(path)
    if not path.exists():
        raise RunError(f'{path}: no such {format_name.split()[1]}')
    data = read_regular(path, MAX_BYTES, RunError)
    try:
        header_size = 8 + int.from_bytes(data[:8], 'little')
        header = json.loads(data[8:header_size])
        record = json.loads(header['__metadata__']['checkpoint'])
        digest, state = record['sha256'], record['state']
        if record['format'] != format_name:
            raise RunError(f'{path}: not a {format_name}')
        place = data.index(digest.encode(), 8, header_size)
    except RunError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RunError(f'{path}: damaged, or not a {format_name}') from None
    summed = hashlib.sha256(data[:place])
    summed.update(_NO_SUM)
    summed.update(memoryview(data)[place + len(_NO_SUM):])
    if summed.hexdigest() != digest:
        raise RunError(f'{path}: damaged checkpoint: its checksum does not match its bytes')
    try:
        return safetensors.numpy.load(data), state
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError) as error:
        raise RunError(f'{path}: damaged checkpoint: {error}') from None
