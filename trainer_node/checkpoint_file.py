# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One safetensors file with everything of a run, written whole or not at all."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import safetensors

from msgs_bridge.atomic_write import atomic_file
from trainer_node.errors import RunError

FORMAT = 'carracing_dqn checkpoint 1'
_NAMES = {'|b1': 'BOOL', '|u1': 'U8', '<i4': 'I32', '<i8': 'I64', '<f4': 'F32', '<f8': 'F64'}
_ALIGNMENT = 8


def write_checkpoint(
    path: Path | str, arrays: dict[str, np.ndarray], state: dict[str, Any],
) -> None:
    """
    Write arrays and a JSON state; on any error the file that was there stays whole.

    The arrays go to the disk as they lie in memory: a replay buffer of a gigabyte is not copied.

    Raises:
        OSError: the folder cannot be written or the disk is full.
    """
    header: dict[str, Any] = {'__metadata__': {'format': FORMAT, 'state': json.dumps(state)}}
    # wide types first, so that everything lies aligned
    ordered = sorted(arrays.items(), key=lambda item: (-item[1].itemsize, item[0]))
    offset = 0
    for name, array in ordered:
        header[name] = {'dtype': _NAMES[array.dtype.str], 'shape': list(array.shape),
                        'data_offsets': [offset, offset + array.nbytes]}
        offset += array.nbytes
    text = json.dumps(header, separators=(',', ':')).encode()
    text += b' ' * (-len(text) % _ALIGNMENT)
    with atomic_file(path) as file:
        file.write(len(text).to_bytes(8, 'little'))
        file.write(text)
        for _, array in ordered:
            file.write(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)


@contextlib.contextmanager
def _opened(path: Path | str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Open a checkpoint and hand on file and state; whatever is wrong is a RunError."""
    path = Path(path)
    if not path.is_file():
        raise RunError(f'{path}: no such checkpoint')
    try:
        with safetensors.safe_open(path, 'np') as file:
            metadata = file.metadata() or {}
            if metadata.get('format') != FORMAT:
                raise RunError(f'{path}: damaged, or not a {FORMAT}')
            yield file, json.loads(metadata['state'])
    except (safetensors.SafetensorError, ValueError, KeyError, OSError) as error:
        if isinstance(error, RunError):
            raise
        raise RunError(f'{path}: damaged checkpoint: {error}') from None


def read_checkpoint(path: Path | str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """
    Read what `write_checkpoint` wrote.

    Raises:
        RunError: the file is missing, cut off or no checkpoint.
    """
    with _opened(path) as (file, state):
        return {name: file.get_tensor(name) for name in file.keys()}, state  # noqa: SIM118


def read_state(path: Path | str) -> dict[str, Any]:
    """
    Return only the JSON state of a checkpoint; the arrays are not read.

    Raises:
        RunError: the file is missing, cut off or no checkpoint.
    """
    with _opened(path) as (_, state):
        return state
