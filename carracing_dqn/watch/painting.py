# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a snapshot looks like in a terminal, as texts of rich."""
from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from PIL import Image
from msgs_bridge.bars import share_between
import numpy as np
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.table import Table
from rich.text import Text

BLOCK = '▀'
BARS = '▁▂▃▄▅▆▇█'
LEVELS = {'ok': 'green', 'warn': 'yellow', 'error': 'red'}
BAD_STATES = ('gone', 'silent')
# columns of a bar of a Q-value
BAR_WIDTH = 12


def picture(pixels: np.ndarray | None, columns: int, rows: int) -> Text:
    """
    Return a picture in half blocks: two pixels a character, one above the other.

    Args:
        pixels: uint8 (H, W, 3) rgb, or None.
        columns: characters at most.
        rows: lines at most.
    """
    if pixels is None or columns < 2 or rows < 1:
        return Text('no picture yet', style='dim')
    height, width, _ = pixels.shape
    part = min(columns / width, 2 * rows / height)
    size = max(1, round(width * part)), max(2, round(height * part) // 2 * 2)
    small = np.asarray(Image.fromarray(np.ascontiguousarray(pixels)).resize(
        size, Image.Resampling.BOX if part < 1 else Image.Resampling.NEAREST))
    text = Text(no_wrap=True, end='')
    for upper, lower in zip(small[::2], small[1::2]):
        for above, below in zip(upper, lower):
            text.append(BLOCK, Style(color=Color.from_rgb(*above), bgcolor=Color.from_rgb(*below)))
        text.append('\n')
    return text


def causes(shown: dict[str, Any], columns: int, rows: int) -> Text:
    """
    Return what is wrong, the worst first, and how much more there is.

    Args:
        shown: a snapshot.
        columns: characters of a line.
        rows: lines at most; what is wrong takes as many of them as it needs.
    """
    found = shown['causes']
    if not found:
        return (Text('nothing is wrong so far, still looking', style='dim') if shown['looking']
                else Text('nothing is wrong that can be seen from here', style='green'))
    lines: list[Text] = []
    console = Console(width=max(columns, 20))
    for place, cause in enumerate(found):
        text = Text()
        text.append(cause['kind'], 'yellow' if cause['kind'] == 'warning' else 'bold red')
        text.append(f' {cause["where"]}: {cause["text"]}')
        if cause['mend']:
            text.append(f'\n  mend: {cause["mend"]}', 'cyan')
        wrapped = text.wrap(console, max(columns, 20))
        last = place == len(found) - 1
        if len(lines) + len(wrapped) > rows - (not last):
            if not lines:
                lines = [*wrapped[:rows - 1 - (not last)], Text('…')]
                place += 1
            if place < len(found):
                lines.append(Text(f'and {len(found) - place} more, below the nodes', 'dim'))
            break
        lines += wrapped
    return Text('\n').join(lines)


def drive(shown: dict[str, Any]) -> Text:
    """Return the numbers of the moment and the Q-values."""
    now = shown['drive']
    text = Text()
    for name, key, digits in (
        ('reward', 'reward', 2), ('return', 'episode_return', 1), ('speed', 'speed', 1),
        ('episode', 'episode', 0), ('decision', 'decision', 0), ('linear', 'linear', 2),
        ('angular', 'angular', 2), ('weights', 'version', 0),
    ):
        text.append(f'{name:<9}', 'dim')
        text.append(f'{number(now.get(key), digits):>8}')
        text.append('\n' if name in ('return', 'episode', 'linear', 'weights') else '   ')
    actions = now.get('actions', [])
    values = [value for _, value in actions if value is not None]
    low, high = min(values, default=0.0), max(values, default=0.0)
    for index, (name, value) in enumerate(actions):
        taken = index in now['chosen']
        # the bars show the differences, which are small beside the values
        part = 0.0 if value is None else share_between(value, low, high)
        text.append(f'{"▶" if taken else " "}{name[:12]:<13}{number(value):>8} ',
                    'bold' if taken else 'dim')
        text.append('█' * max(1, round(part * BAR_WIDTH)), 'green' if taken else 'blue')
        text.append('  random\n' if taken and now['explored'] else '\n')
    return text


def nodes(shown: dict[str, Any]) -> Table:
    """Return the nodes with their health."""
    table = _table('node', 'is', 'says', 's ago')
    for node in shown['nodes']:
        state = node['level'] if node['state'] == 'running' else node['state']
        style = 'red' if state in BAD_STATES else LEVELS.get(state, 'dim')
        table.add_row(Text(node['name']), Text(state, style), Text(node['summary']),
                      Text(number(node['age'], 1), justify='right'))
    return table


def topics(shown: dict[str, Any]) -> Table:
    """Return the topics with who publishes and who hears them."""
    table = _table('topic', 'Hz', 's ago', 'from', 'to')
    for topic in shown['topics']:
        to = Text(_ends(topic['subscriptions'], shown['namespace']))
        for misfit in topic['misfits']:
            to.append(f'\n{misfit["publisher"]} -> {misfit["subscription"]}: {misfit["reason"]}',
                      'red')
        table.add_row(Text(topic['name']), Text(number(topic['rate'], 1), justify='right'),
                      Text(number(topic['age'], 1), justify='right'),
                      Text(_ends(topic['publishers'], shown['namespace'])), to)
    return table


def plots(shown: dict[str, Any], columns: int) -> Text:
    """Return each plot as its name, its numbers and a line of bars."""
    text = Text()
    for name, points in shown['plots'].items():
        values = [value for _, value in points if value is not None]
        if not values:
            continue
        text.append(f'{name[:30]} ', 'bold')
        text.append(f'{_plotted(values[-1])}   {_plotted(min(values))} to '
                    f'{_plotted(max(values))}, {points[0][0]:.0f} s\n', 'dim')
        text.append(spark([(ago, value) for ago, value in points if value is not None],
                          max(columns, 10)) + '\n', 'blue')
    return text if text else Text('nothing to plot yet', style='dim')


def spark(points: Sequence[tuple[float, float]], columns: int, rows: int = 1) -> str:
    """Return (seconds ago, value) as bars in lines of some columns, oldest first."""
    oldest = points[0][0]
    low, high = min(value for _, value in points), max(value for _, value in points)
    cells: list[float | None] = [None] * columns
    for ago, value in points:
        cells[min(columns - 1, int((1 - share_between(ago, 0.0, oldest)) * columns))] = value
    known = low
    # heights in eighths of a line, at least one
    heights, most = [], rows * len(BARS)
    for cell in cells:
        known = known if cell is None else cell
        heights.append(1 + min(most - 1, int(share_between(known, low, high) * most)))
    return '\n'.join(
        ''.join((' ' + BARS)[min(max(height - below, 0), len(BARS))] for height in heights)
        for below in range(most - len(BARS), -1, -len(BARS)))


def number(value: float | None, digits: int = 2) -> str:
    """Return a number, '-' for none."""
    return '-' if value is None or not math.isfinite(value) else f'{value:.{digits}f}'


def _plotted(value: float) -> str:
    """Return a number of any size in few characters."""
    return number(value) if value == 0 or 0.1 <= abs(value) < 1e6 else f'{value:.2g}'


def _ends(ends: Sequence[dict[str, Any]], namespace: str | None) -> str:
    """Return nodes, a line each; those of the car that is shown without its namespace."""
    return '\n'.join(end['node'].removeprefix(f'{namespace or ""}/')
                     + ('' if end['reliable'] else ' (best effort)') for end in ends) or '-'


def _table(*columns: str) -> Table:
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0))
    for name in columns:
        table.add_column(name, overflow='fold', no_wrap=name in ('is', 'Hz', 's ago'),
                         justify='right' if name in ('Hz', 's ago') else 'left',
                         # these share what room there is
                         ratio=1 if name in ('says', 'from', 'to') else None)
    return table
