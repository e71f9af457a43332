# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiles inner loops over images and tracks with Numba, and keeps the result where that is safe.

What Numba keeps on disk is a pickle of machine code: whoever can write it runs code in every node.
So it is kept in a folder of the user's in which nobody else can write (`NUMBA_CACHE_DIR`,
`carracing_dqn` in the user's cache folder, or else in a temporary one), each file with its hash,
and never beside the sources. Without such a folder, or where a file is damaged, the loops are
compiled anew.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import functools
import hashlib
import io
import os
from pathlib import Path
from typing import Any
import warnings

from msgs_bridge.private_folder import make_private, make_temporary, user_cache_folder
from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

HASH_BYTES = 32


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    Compile `function` at its first call, or take what was compiled before.

    Division by zero follows NumPy, so that no loop carries a check.
    """
    dispatcher = njit(nogil=True, error_model='numpy')(function)
    if cache_folder() is not None:
        dispatcher._cache = _PrivateCache(function)
    return dispatcher


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder that compiled code is kept in; None, with a warning, if there is none."""
    given = os.environ.get('NUMBA_CACHE_DIR')
    try:
        return make_private(Path(given) if given else user_cache_folder() / 'carracing_dqn')
    except (OSError, RuntimeError):  # RuntimeError: the user has no home
        pass
    try:
        return make_temporary('carracing_dqn')
    except OSError as error:
        warnings.warn(
            f'compiled loops are not kept, so that every start takes some seconds more: {error}',
            RuntimeWarning, stacklevel=2)
        return None


class _Locator:
    """Tells Numba where a function's files lie and when they are out of date."""

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        self._py_file = source
        self._line = function.__code__.co_firstlineno
        self._hash = hashlib.sha256(Path(source).read_bytes()).hexdigest()

    @classmethod
    def from_function(cls, function: Callable[..., Any], source: str) -> _Locator:
        return cls(function, source)

    def get_cache_path(self) -> str:
        # by content, so that a checkout and an install share what is compiled
        return str(cache_folder() / f'{Path(self._py_file).stem}-{self._hash[:16]}')

    def ensure_cache_path(self) -> None:
        make_private(Path(self.get_cache_path()))

    def get_source_stamp(self) -> str:
        return self._hash

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]


class _HashedFile(IndexDataCacheFile):
    """Ends every file with the hash of what stands before, which pickle passes over."""

    @contextlib.contextmanager
    def _open_for_write(self, path: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(path) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if self._is_whole(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        return super()._load_data(name) if self._is_whole(path) else None

    @staticmethod
    def _is_whole(path: str) -> bool:
        try:
            content = Path(path).read_bytes()
        except OSError:
            return False
        return hashlib.sha256(content[:-HASH_BYTES]).digest() == content[-HASH_BYTES:]


class _PrivateCache(FunctionCache):
    """A cache that never ends a process: what cannot be read or written is compiled anew."""

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _HashedFile(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def load_overload(self, signature: Any, target: Any) -> Any:
        with contextlib.suppress(Exception):
            self._impl.locator.ensure_cache_path()
            return super().load_overload(signature, target)
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        # a full disk, a folder that was removed
        with contextlib.suppress(OSError):
            super().save_overload(signature, result)
