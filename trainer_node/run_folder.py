# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The folder of a run: what lies where.

`docs/architecture.md` has the table of its files.
"""
from __future__ import annotations

from datetime import datetime, timezone
import json
import os
from pathlib import Path
import tempfile
from typing import Any

from msgs_bridge.atomic_write import remove_leftovers, write_text
from msgs_bridge.file_lock import lock
from msgs_bridge.regular_file import read_regular
from trainer_node.errors import RunError

MAX_RECORD_BYTES = 16 * 2**20

# folders that this process learns into, by what the system knows them by; open until it ends
_locked: dict[tuple[int, int], int] = {}


class RunFolder:
    """Paths of a run folder, and its `run.json`."""

    def __init__(self, folder: Path | str) -> None:
        """Name the folder; nothing is read or written yet."""
        self.path = Path(folder)
        self.config = self.path / 'config.yaml'
        self.record = self.path / 'run.json'
        self.episodes = self.path / 'episodes.csv'
        self.validation = self.path / 'validation.csv'
        self.updates = self.path / 'updates.csv'
        self.cars = self.path / 'cars.csv'
        self.checkpoint = self.path / 'checkpoint' / 'checkpoint.safetensors'
        self.best = self.path / 'best'
        self.final = self.path / 'final'
        self.tensorboard = self.path / 'tensorboard'

    @property
    def unfinished_start(self) -> bool:
        """Return whether a run was begun here and killed before its first checkpoint."""
        return self.config.is_file() and not any(
            path.exists() for path in (self.checkpoint, self.best, self.final))

    def make(self) -> bool:
        """
        Make an empty folder; return whether there was none.

        Raises:
            RunError: the place cannot be written.
        """
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            return False
        except OSError as error:
            raise RunError(f'{self.path}: {error.strerror}') from None
        return True

    def create(self) -> None:
        """
        Make the folder; what is left of a run without a checkpoint is removed.

        Raises:
            RunError: a run is there already, or the place cannot be written.
        """
        try:
            if self.unfinished_start:
                for path in (
                        self.record, self.episodes, self.validation, self.updates, self.cars):
                    path.unlink(missing_ok=True)
            elif self.config.exists() or self.checkpoint.exists():
                raise RunError(
                    f'{self.path} holds a run already; resume it or name another folder')
            self.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(f'{error.filename or self.path}: {error.strerror}') from None

    def lock(self) -> None:
        """
        Keep other processes from learning into the folder until `unlock` or the process's end.

        Raises:
            RunError: another one does already.
        """
        try:
            handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise RunError(f'{self.path}: {error.strerror}') from None
        found = os.fstat(handle)
        place = found.st_dev, found.st_ino
        if place in _locked:
            os.close(handle)
            return
        if lock(handle, RunError(f'{self.path}: another process learns into it')):
            _locked[place] = handle
        else:
            os.close(handle)

    def unlock(self) -> None:
        """Let other processes learn into the folder."""
        try:
            found = self.path.stat()
        except OSError:
            # it was removed, and nobody can open it
            return
        handle = _locked.pop((found.st_dev, found.st_ino), None)
        if handle is not None:
            os.close(handle)

    def check_writable(self) -> None:
        """
        See that files can be written, before anything is started that needs to.

        Raises:
            RunError: they cannot.
        """
        try:
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise RunError(f'{self.path} cannot be written: {error.strerror}') from None

    def remove_leftovers(self) -> None:
        """Remove what a killed process was in the middle of writing."""
        remove_leftovers(self.path, *(
            path.name for path in (self.config, self.record, self.best, self.final)),
            # of commands that work on the run
            'demonstrations.safetensors', 'plan.yaml', 'evaluation*.json')
        remove_leftovers(
            self.checkpoint.parent, self.checkpoint.name, 'observations-*.safetensors')

    def read_record(self) -> dict[str, Any]:
        """Return `run.json`, empty if there is none or it cannot be read."""
        try:
            record = json.loads(read_regular(self.record, MAX_RECORD_BYTES, RunError))
        except (ValueError, RecursionError):  # a RunError among them
            return {}
        if not isinstance(record, dict) or not isinstance(record.get('sessions', []), list):
            return {}
        return record

    def write_record(self, record: dict[str, Any]) -> None:
        """Write `run.json`; raises RunError."""
        self._write(self.record, json.dumps(record, indent=1) + '\n')

    def write_config(self, text: str) -> None:
        """Write `config.yaml`; raises RunError."""
        self._write(self.config, text)

    def _write(self, path: Path, text: str) -> None:
        try:
            write_text(path, text)
        except OSError as error:
            raise RunError(f'{path} cannot be written: {error.strerror}') from None


def now() -> str:
    """Return the time of day in UTC, to the second."""
    return datetime.now(timezone.utc).isoformat(timespec='seconds')
