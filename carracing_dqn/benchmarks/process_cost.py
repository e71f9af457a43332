# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What processes cost, out of /proc: processor seconds, memory, bytes on the loopback device."""
from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

TICKS = os.sysconf('SC_CLK_TCK')
PAGE = os.sysconf('SC_PAGE_SIZE')


class Cost(NamedTuple):
    """Processor seconds so far and resident bytes that are of no file or shared memory."""

    seconds: float
    resident: int


def cost_of(pid: int) -> Cost:
    """Return what a process has cost so far; nothing if it is gone."""
    try:
        # the name in brackets may hold anything
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
        pages = Path(f'/proc/{pid}/statm').read_text().split()
    except OSError:
        return Cost(0.0, 0)
    return Cost((int(fields[11]) + int(fields[12])) / TICKS,
                (int(pages[1]) - int(pages[2])) * PAGE)


def children_of(pid: int) -> dict[int, str]:
    """Return the command line of each child of a process, by its number."""
    found = {}
    for path in Path('/proc').glob('[0-9]*'):
        try:
            parent = int((path / 'stat').read_text().rpartition(')')[2].split()[1])
            if parent == pid:
                found[int(path.name)] = (path / 'cmdline').read_bytes().replace(
                    b'\0', b' ').decode(errors='replace')
        except OSError:
            continue
    return found


def loopback_bytes() -> int:
    """Return how many bytes the loopback device has carried."""
    for line in Path('/proc/net/dev').read_text().splitlines():
        name, _, fields = line.partition(':')
        if name.strip() == 'lo':
            return int(fields.split()[0])
    return 0
