# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""CSV files read as columns of numbers, also while they are being written."""
from __future__ import annotations

from array import array
import csv
import dataclasses
import io
from pathlib import Path

from carracing_dqn.evaluation.errors import RecordsError
from msgs_bridge.regular_file import read_regular
import numpy as np

MAX_BYTES = 64 * 2**20
MAX_COLUMNS = 1000
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
        data = read_regular(path, MAX_BYTES, RecordsError)
    except RecordsError as error:
        return Table(), [f'{path.name} was not read: {str(error).removeprefix(f"{path}: ")}.']
    if not data.strip():
        return Table(), [f'{path.name} is empty.']
    # a row at a time: as lists of texts all of them take thirty times the bytes of the file
    reader = csv.reader(io.TextIOWrapper(
        io.BytesIO(data.replace(b'\0', b'')), 'utf-8', 'replace', newline=''))
    try:
        header = next(reader)
        if len(header) > MAX_COLUMNS:
            return Table(), [f'{path.name} has {len(header)} columns; accepted: {MAX_COLUMNS}.']
        numbers = [array('d') for _ in header]
        odd, strange, last = 0, [0] * len(header), None
        for row in reader:
            if last is not None:
                odd += not _take(last, numbers, strange)
            last = row
        problems = []
        if last is not None and not data.endswith(b'\n'):
            # somebody is writing it, or was stopped while doing so: the last row may be half a row
            problems.append(f'{path.name} ends in the middle of a row, which was left out.')
        elif last is not None:
            odd += not _take(last, numbers, strange)
    except csv.Error as error:
        return Table(), [f'{path.name} is not a CSV file: {error}.']
    if odd:
        problems.append(f'{path.name}: {_rows(odd)} with another number of cells than the header '
                        'left out.')
    columns = {name: np.array(column) for name, column in zip(header, numbers)}
    problems += [f'{path.name}: {_rows(count)} in which {name} is no number.'
                 for name, count in zip(header, strange) if count and name in expected]
    missing = [name for name in expected if name not in columns]
    if missing:
        problems.append(f'{path.name} has no column {", ".join(missing)}.')
    rows = len(numbers[0]) if numbers else 0
    if not rows:
        problems.append(f'{path.name} has no row yet.')
    return Table(columns, rows), problems


def _take(row: list[str], numbers: list[array], strange: list[int]) -> bool:
    """Put a row into the columns, and count what is no number; False if it does not fit."""
    if len(row) != len(numbers):
        return False
    for place, cell in enumerate(row):
        value = _number(cell)
        numbers[place].append(value)
        strange[place] += value != value and bool(cell.strip())
    return True


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
