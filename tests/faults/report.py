# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What was tried and survived, as tables and as data."""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
import dataclasses
import json
from pathlib import Path
import statistics

from faults.outcome import Outcome

GROUPS = {
    'message': 'A topic between two nodes',
    'process': 'A node that runs',
    'command': 'A whole command',
    'file': 'A file, and a command that reads it',
}
SHOWN = 160


def markdown(outcomes: Sequence[Outcome]) -> str:
    """Return one table for each group: a row for each fault and place."""
    parts = []
    for group, title in GROUPS.items():
        rows = defaultdict(list)
        for outcome in outcomes:
            if outcome.group == group:
                rows[outcome.fault, outcome.where].append(outcome)
        if not rows:
            continue
        all_of = [outcome for row in rows.values() for outcome in row]
        parts.append(
            f'### {title}: {sum(one.survived for one in all_of)} of {len(all_of)}\n\n'
            '| fault | where | tried | survived | longest, s | what was wrong |\n'
            '|---|---|---:|---:|---:|---|\n' + ''.join(map(_row, sorted(rows.items()))))
    return '\n'.join(parts)


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return one table of all faults, wherever they were, and a line for each not survived."""
    rows = defaultdict(list)
    for outcome in outcomes:
        rows[list(GROUPS).index(outcome.group), outcome.fault].append(outcome)
    lines = ['| fault of | kind | tried | survived | median, s | longest, s |',
             '|---|---|---:|---:|---:|---:|']
    for (group, fault), tried in sorted(rows.items()):
        seconds = [one.seconds for one in tried if one.seconds is not None] or [float('nan')]
        lines.append(
            f'| {list(GROUPS)[group]} | {fault} | {len(tried)} | '
            f'{sum(one.survived for one in tried)} | {statistics.median(seconds):.1f} | '
            f'{max(seconds):.1f} |')
    lines.append('')
    lines += [f'- {one.fault}, {one.where}: {"; ".join(one.problems)[:SHOWN]}'
              for one in outcomes if not one.survived]
    return '\n'.join(lines) + '\n'


def _row(item: tuple[tuple[str, str], list[Outcome]]) -> str:
    (fault, where), tried = item
    seconds = [one.seconds for one in tried if one.seconds is not None]
    wrong = sorted({problem for one in tried for problem in one.problems})
    text = '; '.join(wrong)[:SHOWN].replace('|', '/').replace('\n', ' ')
    return (f'| {fault} | {where} | {len(tried)} | {sum(one.survived for one in tried)} | '
            f'{max(seconds, default=float("nan")):.1f} | {text} |\n')


def write(outcomes: Sequence[Outcome], folder: Path, head: str) -> None:
    """Write `faults.md` and `faults.json`; the latter has the seed of every single one."""
    (folder / 'faults.md').write_text(f'{head}\n\n{summary(outcomes)}\n{markdown(outcomes)}')
    (folder / 'faults.json').write_text(json.dumps(
        [dataclasses.asdict(outcome) for outcome in outcomes], indent=1))
