# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""CSV files read as columns of numbers, also while they are being written."""
from __future__ import annotations

import csv
import dataclasses
import io
from pathlib import Path

from carracing_dqn.evaluation.errors import RecordsError
from msgs_bridge.regular_file import read_regular
import numpy as np

MAX_BYTES = 256 * 2**20
# no count and no return comes near to it, and axes of more overflow
LARGEST = 1e15


@dataclasses.dataclass(frozen=True)
class Table:
    """
    Columns of one length.

    Attributes:
        columns: float (rows,) by name; NaN where a cell was empty or no number.
        rows: number of rows.
    """

    columns: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    rows: int = 0

    def has(self, *names: str) -> bool:
        """Return whether each of the columns is there and holds a number."""
        return all(
            name in self.columns and bool(np.isfinite(self.columns[name]).any())
            for name in names)

    def known(self, *names: str) -> list[np.ndarray]:
        """Return columns, each float (n,), in the rows in which all of them hold a number."""
        columns = [self.columns[name] for name in names]
        complete = np.all([np.isfinite(column) for column in columns], axis=0)
        return [column[complete] for column in columns]


def read_table(path: Path, expected: tuple[str, ...]) -> tuple[Table, list[str]]:
    """
    Read a CSV file of numbers; never fails.

    Args:
        path: the file.
        expected: columns it should have.

    Returns:
        What could be read, and a sentence for everything that was wrong.
    """
    if not path.exists():
        return Table(), [f'{path.name} is not there.']
    try:
        text = read_regular(path, MAX_BYTES, RecordsError).decode('utf-8', 'replace')
    except RecordsError as error:
        return Table(), [f'{path.name} was not read: {str(error).removeprefix(f"{path}: ")}.']
    if not text.strip():
        return Table(), [f'{path.name} is empty.']
    unfinished = not text.endswith('\n')
    try:
        header, *rows = list(csv.reader(io.StringIO(text.replace('\0', ''))))
    except csv.Error as error:
        return Table(), [f'{path.name} is not a CSV file: {error}.']
    problems = []
    if unfinished and rows:
        # somebody is writing it, or was stopped while doing so: the last row may be half a row
        rows.pop()
        problems.append(f'{path.name} ends in the middle of a row, which was left out.')
    whole = [row for row in rows if len(row) == len(header)]
    if len(whole) < len(rows):
        problems.append(
            f'{path.name}: {_rows(len(rows) - len(whole))} with another number of cells than '
            'the header left out.')
    columns = {
        name: np.array([_number(row[place]) for row in whole], dtype=float)
        for place, name in enumerate(header)}
    for name, column in columns.items():
        strange = sum(
            1 for row, value in zip(whole, column)
            if np.isnan(value) and row[header.index(name)].strip())
        if strange and name in expected:
            problems.append(f'{path.name}: {_rows(strange)} in which {name} is no number.')
    missing = [name for name in expected if name not in columns]
    if missing:
        problems.append(f'{path.name} has no column {", ".join(missing)}.')
    if not whole:
        problems.append(f'{path.name} has no row yet.')
    return Table(columns, len(whole)), problems


def _rows(count: int) -> str:
    return '1 row' if count == 1 else f'{count} rows'


def _number(cell: str) -> float:
    """Return a number that can be drawn, or NaN."""
    try:
        value = float(cell)
    except ValueError:
        return float('nan')
    # written so that NaN fails: every comparison with it is False
    return value if abs(value) <= LARGEST else float('nan')
