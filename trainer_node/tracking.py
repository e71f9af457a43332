# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a run writes down: CSV files, and TensorBoard's event files on request."""
from __future__ import annotations

import contextlib
import csv
import io
import os
from pathlib import Path
from typing import Any

from trainer_node.errors import RunError
from trainer_node.run_folder import RunFolder

FILES = ('episodes', 'validation', 'updates')

# the report's columns (4.2.3) first, then more
EPISODE_COLUMNS = (
    'episode', 'train_reward', 'validation_reward', 'epsilon', 'learning_rate',
    'frames', 'decisions', 'lap_finished', 'ended_early', 'tiles_visited', 'tiles_total',
    'standing_still', 'loss', 'q_mean', 'td_error', 'updates', 'replay_size', 'replay_ratio',
    'weights_version', 'wall_seconds')
VALIDATION_COLUMNS = (
    'version', 'episode', 'decisions', 'updates', 'wall_seconds', 'episodes', 'mean', 'std',
    'minimum', 'maximum', 'completed', 'seconds')

CAR_COLUMNS = ('source', 'episode', 'seed', 'train_reward', 'frames', 'run_episode',
               'decisions', 'weights_version', 'wall_seconds')


def update_columns(figures: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of `updates.csv` for a learner that gives some figures."""
    return ('updates', 'decisions', *figures, 'learning_rate', 'epsilon', 'wall_seconds',
            'updates_per_second')


class CsvFile:
    """A CSV file that grows row by row and can be set back to an earlier length."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """
        Open or begin the file.

        Raises:
            RunError: the file cannot be written, or has other columns.
        """
        self.path = path
        self.columns = columns
        if path.exists() and not path.is_file():
            raise RunError(f'{path}: not a regular file')
        try:
            self._file = open(path, 'ab')  # noqa: SIM115
        except OSError as error:
            raise RunError(f'{path}: {error.strerror}') from None
        header = _row(columns)
        self.least = len(header)
        if self._file.tell() == 0:
            self._append(columns)
        with open(path, 'rb') as file:
            if file.read(len(header)) != header:
                raise RunError(f'{path}: expected the columns {", ".join(columns)}')

    def write(self, values: dict[str, Any]) -> None:
        """Append a row; a column without a value stays empty; raises RunError."""
        self._append([_cell(values.get(column)) for column in self.columns])

    def position(self) -> int:
        """Return the length in bytes, all of it on the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())
        return os.fstat(self._file.fileno()).st_size

    def check(self, position: int) -> None:
        """
        See that the file can be cut to an earlier length.

        Raises:
            RunError: the file is shorter than that, or that is no place after its columns.
        """
        size = os.fstat(self._file.fileno()).st_size
        if not self.least <= position <= size:
            raise RunError(f'{self.path}: {size} bytes, but {position} at the checkpoint')

    def set_back(self, position: int) -> None:
        """Cut the file to an earlier length."""
        self._file.truncate(position)

    def close(self) -> None:
        """Close the file; what could not be written has been told."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _append(self, cells: Any) -> None:
        """Write a row; raises RunError."""
        try:
            self._file.write(_row(cells))
            self._file.flush()
        except OSError as error:
            raise RunError(f'{self.path} cannot be written: {error.strerror}') from None


def _row(cells: Any) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator='\n').writerow(cells)
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else f'{value:.6g}'
    return '' if value is None else int(value) if isinstance(value, bool) else value


class Tracking:
    """
    The CSV files of a run, and TensorBoard when asked for.

    The one about cars is there from the first episode on of a source with a name.
    """

    def __init__(
        self, folder: RunFolder, figures: tuple[str, ...], *, tensorboard: bool = False,
    ) -> None:
        """Open the files for a learner that gives some figures; raises RunError."""
        self.episodes = CsvFile(folder.episodes, EPISODE_COLUMNS)
        self.validation = CsvFile(folder.validation, VALIDATION_COLUMNS)
        self.updates = CsvFile(folder.updates, update_columns(figures))
        self._cars_path = folder.cars
        self.cars = self._open_cars() if folder.cars.exists() else None
        self._writer = None
        if tensorboard:
            self._writer = _tensorboard_writer(folder.tensorboard)

    def episode(self, values: dict[str, Any]) -> None:
        """Write a training episode down."""
        self.episodes.write(values)
        self._scalars(values['decisions'], {
            'charts/episodic_return': values['train_reward'],
            'charts/episodic_length': values.get('frames'),
            'charts/epsilon': values['epsilon'],
            'charts/lap_finished': values.get('lap_finished'),
        })

    def _open_cars(self) -> CsvFile:
        return CsvFile(self._cars_path, CAR_COLUMNS)

    def car_episode(self, values: dict[str, Any]) -> None:
        """Write down whose training episode it was."""
        if self.cars is None:
            self.cars = self._open_cars()
        self.cars.write(values)

    def validated(self, values: dict[str, Any]) -> None:
        """Write a validation down."""
        self.validation.write(values)
        self._scalars(values['decisions'], {
            'charts/validation_return': values['mean'],
            'charts/validation_completed': values['completed'],
        })

    def updated(self, values: dict[str, Any]) -> None:
        """Write the figures of some hundred updates down."""
        self.updates.write(values)
        self._scalars(values['decisions'], {
            'losses/td_loss': values.get('loss'),
            'losses/q_values': values.get('q_mean'),
            'charts/learning_rate': values['learning_rate'],
            'charts/updates_per_second': values['updates_per_second'],
        })

    def positions(self) -> dict[str, int]:
        """Return the length of each CSV file."""
        return {name: getattr(self, name).position() for name in self._files}

    @property
    def _files(self) -> tuple[str, ...]:
        return FILES if self.cars is None else (*FILES, 'cars')

    def check(self, positions: dict[str, int]) -> None:
        """See that the CSV files can be cut to the lengths of a checkpoint; raises RunError."""
        for name in FILES:
            getattr(self, name).check(positions[name])
        if self.cars is not None:
            self.cars.check(positions.get('cars', self.cars.least))
        elif 'cars' in positions:
            raise RunError(f'{self._cars_path}: it is gone, and was there at the checkpoint')

    def set_back(self, positions: dict[str, int]) -> None:
        """Cut the CSV files to lengths that were checked."""
        for name in self._files:
            file = getattr(self, name)
            # one that was begun after the checkpoint is left without a row
            file.set_back(positions.get(name, file.least))

    def close(self) -> None:
        """Close all files."""
        for name in self._files:
            getattr(self, name).close()
        if self._writer is not None:
            self._writer.close()

    def _scalars(self, step: int, values: dict[str, float]) -> None:
        if self._writer is not None:
            for name, value in values.items():
                if value is not None:
                    self._writer.add_scalar(name, float(value), int(step))


def _tensorboard_writer(folder: Path) -> Any:
    """Return a writer of event files; raises RunError if TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise RunError('event files need the package tensorboard: '
                       'pip install tensorboard') from None
    return SummaryWriter(str(folder))
