# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Safe looks at names and texts from outside."""
from __future__ import annotations


def plain(text: str, most: int = 100) -> str:
    """Return a text without control characters, cut."""
    text = ''.join(one if one.isprintable() else '?' for one in text)
    return text if len(text) <= most else f'{text[:most - 1]}…'
