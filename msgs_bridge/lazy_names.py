# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Names that a package hands on without importing their modules until they are used."""
from __future__ import annotations

from collections.abc import Callable
import importlib
from typing import Any


def lazy_names(package: str, places: dict[str, str]) -> Callable[[str], Any]:
    """
    Return the `__getattr__` of a package.

    Args:
        package: its `__name__`.
        places: name -> module of the package in which it is defined.
    """
    def find(name: str) -> Any:
        if name not in places:
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        return getattr(importlib.import_module(f'{package}.{places[name]}'), name)

    return find
