# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import tempfile
from typing import BinaryIO


@contextlib.contextmanager
def atomic_file(path: Path | str) -> Iterator[BinaryIO]:
    """
    Open a new file that takes the place of `path` only when the block ends well.

    The bytes are on the disk before the rename. On any error, a full disk included, the old
    file stays as it was and the new one is removed.

    Raises:
        OSError: the folder cannot be written or the disk is full.
    """
    path = Path(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
    try:
        with os.fdopen(handle, 'wb') as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a whole file atomically (see `atomic_file`)."""
    with atomic_file(path) as file:
        file.write(data)


def write_text(path: Path | str, text: str) -> None:
    """Write a whole UTF-8 text file atomically (see `atomic_file`)."""
    write_bytes(path, text.encode())
