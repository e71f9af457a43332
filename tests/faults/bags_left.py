# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that a fault has left behind: whole, or something that can be made whole."""
from __future__ import annotations

from pathlib import Path

from faults.command_process import run_command

SECONDS = 120.0


def what_is_wrong(bag: Path, folder: Path) -> list[str]:
    """Return what is wrong with a bag; that it says itself what it lacks is not."""
    ended = None
    whole = folder / f'{bag.name}_whole'
    for words in (('bag', 'verify', '--structure-only', str(bag)),
                  ('bag', 'recover', str(bag), str(whole))):
        ended = run_command(words, folder, seconds=SECONDS)
        if problems := ended.problems():
            return [f'{words[1]} of {bag.name}: {problem}' for problem in problems]
        if ended.code in (0, 1):
            return []
    return [f'{bag.name} cannot be made whole: {ended.last_line[:150]}']
