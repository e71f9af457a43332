# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Compiles inner loops over pictures and tracks with Numba."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    Compile `function` at its first call and keep the result on disk where that is possible.

    Numba keeps it beside the source file or, where that is read-only, in the user's cache
    directory; with neither it compiles anew in every process, which takes some seconds.
    Division by zero follows NumPy, so that no loop carries a check.
    """
    return _kept(lambda **options: njit(nogil=True, error_model='numpy', **options)(function))


def _kept(compile_with: Callable[..., Any]) -> Any:
    try:
        return compile_with(cache=True)
    except RuntimeError:
        return compile_with()
