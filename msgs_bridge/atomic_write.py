# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files and folders that are there whole or not at all."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import ctypes
import errno
import os
from pathlib import Path
import shutil
import tempfile
from typing import BinaryIO

# of linux/fs.h and fcntl.h
_RENAME_EXCHANGE = 2
_AT_FDCWD = -100


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


@contextlib.contextmanager
def atomic_folder(path: Path | str) -> Iterator[Path]:
    """
    Make a new folder that takes the place of `path` only when the block ends well.

    A folder that is there is exchanged for the new one in one step, so at every moment there is
    a whole one. Where the file system or the C library cannot do that, it is moved away first,
    and `remove_leftovers` puts it back if the process was killed in between.

    Raises:
        OSError: the place cannot be written or the disk is full; an old folder stays.
    """
    path = Path(path)
    temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix=f'.{path.name}.'))
    try:
        new, old = temporary / 'new', temporary / 'old'
        new.mkdir()
        yield new
        if not path.exists():
            new.rename(path)
        elif not _exchange(new, path):
            path.rename(old)
            try:
                new.rename(path)
            except OSError:
                old.rename(path)
                raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _exchange(first: Path, second: Path) -> bool:
    """Exchange what two names stand for, in one step; False where that cannot be done."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:  # a C library without it
        return False
    done = renameat2(
        _AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE)
    if done == 0:
        return True
    error = ctypes.get_errno()
    if error in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        return False
    raise OSError(error, os.strerror(error), str(second))


def remove_leftovers(folder: Path | str, *names: str) -> None:
    """
    Remove what writers of this module left in a folder when they were killed.

    Call it only where no other process writes these files.

    Args:
        folder: where to look.
        names: of the files and folders that were written, as patterns of glob.
    """
    for name in names:
        for path in Path(folder).glob(f'.{name}.' + '[a-z0-9_]' * 8):
            with contextlib.suppress(OSError):
                if path.is_symlink() or not path.is_dir():
                    path.unlink()
                    continue
                place = path.parent / path.name[1:].rpartition('.')[0]
                if (path / 'old').is_dir() and not place.exists():
                    (path / 'old').rename(place)
                shutil.rmtree(path)
