# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Texts from outside, as they may reach a log, a terminal or the diagnostics."""
from __future__ import annotations

# of a text from outside, this much says what it is
LENGTH = 100


def plain(text: object, length: int = LENGTH) -> str:
    """Return a text in one line of at most so many characters, what cannot be printed as `?`."""
    # cut first: a text may have megabytes
    text = str(text)[:length + 1]
    shown = ''.join(letter if letter.isprintable() else '?' for letter in text)
    return shown if len(shown) <= length else shown[:length - 1] + '…'
