# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How an evaluation looks while it goes on: a bar on a terminal, plain lines otherwise."""
from __future__ import annotations

import time

from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.statistics import Statistics, statistics_of
from msgs_bridge.plain_text import plain
from msgs_bridge.terminal import say
from rich.console import Console
from rich.progress import (
    BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

LINE_SECONDS = 10.0
"""Seconds between two plain lines, when nobody watches."""


class LapProgress:
    """Shows laps as they come in; a context manager."""

    def __init__(self, laps: list[Lap], wanted: int, console: Console) -> None:
        """Start from the laps that are there already."""
        self._laps = list(laps)
        self._wanted = wanted
        self._console = console
        self._next_line = 0.0
        self._bar = None
        # one that cannot move its cursor shows no bar before the end
        if console.is_terminal and not console.is_dumb_terminal:
            self._bar = Progress(
                TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
                TimeElapsedColumn(), TimeRemainingColumn(), console=console)
            self._task = self._bar.add_task(
                self._summary(), total=wanted, completed=len(self._laps))

    def __enter__(self) -> LapProgress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def add(self, lap: Lap) -> None:
        """Show one more lap."""
        self._laps.append(lap)
        if self._bar is not None:
            self._bar.update(self._task, advance=1, description=self._summary())
        elif time.monotonic() >= self._next_line or len(self._laps) == self._wanted:
            self._next_line = time.monotonic() + LINE_SECONDS
            say(self._console,
                f'lap {len(self._laps)} of {self._wanted}: {self._summary()} '
                f'(seed {lap.seed}: {lap.episode_return:.1f} in {lap.frames} frames)')

    def _summary(self) -> str:
        if not self._laps:
            return 'no lap yet'
        mean = sum(lap.episode_return for lap in self._laps) / len(self._laps)
        finished = [lap.lap_finished for lap in self._laps]
        return f'mean {mean:.1f}' + ('' if None in finished else f', {sum(finished)} finished')


def summary_table(name: str, laps: list[Lap]) -> Table:
    """Return the statistics of laps as a table for the terminal."""
    table = Table(title=Text(f'{len(laps)} laps of {plain(name)}'), title_justify='left',
                  show_header=False)
    table.add_column()
    table.add_column(justify='right')
    for label, text in summary_rows(statistics_of(laps)):
        table.add_row(label, text)
    return table


def summary_rows(numbers: Statistics) -> list[tuple[str, str]]:
    """Return label and text of each number worth reading."""
    quantiles = ', '.join(
        f'{share:.0%} {value:.1f}' for share, value in numbers.quantiles.items())
    rows = [
        ('mean return', f'{numbers.mean:.2f} ± {numbers.std:.2f}'),
        ('95 % confidence interval of the mean (bootstrap)',
         f'{numbers.mean_low:.2f} to {numbers.mean_high:.2f}'),
        ('median', f'{numbers.median:.2f}'),
        ('minimum, maximum', f'{numbers.minimum:.2f}, {numbers.maximum:.2f}'),
        ('quantiles', quantiles),
    ]
    if numbers.completed is not None:
        rows.append((
            'laps finished', f'{numbers.completed:.1%}, 95 % confidence '
            f'{numbers.completed_low:.1%} to {numbers.completed_high:.1%} (Wilson)'))
        # thresholds of CarRacing's returns
        rows += [(f'return of {threshold} or more', f'{share:.1%}')
                 for threshold, share in numbers.success.items()]
    lap_frames = '' if numbers.lap_frames is None else f', finished ones {numbers.lap_frames:.1f}'
    rows.append(('frames of an episode', f'{numbers.frames:.1f}{lap_frames}'))
    return rows + [(label, format(value, form)) for label, value, form in (
        ('tiles visited', numbers.tiles, '.2%'),
        ('stood still at the end for more than 100 frames', numbers.stopped, '.1%'),
        ('left the field', numbers.left_field, '.1%'),
    ) if value is not None]
