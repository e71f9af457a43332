# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The folder of a run: what lies where, and what is known of the machine it ran on.

`docs/architecture.md` has the table of its files.
"""
from __future__ import annotations

from datetime import datetime, timezone
import importlib.metadata
import json
import os
from pathlib import Path
import platform
import subprocess
from typing import Any

from msgs_bridge.atomic_write import write_text
from trainer_node.errors import RunError

LIBRARIES = ('torch', 'numpy', 'gymnasium', 'safetensors')


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
        self.checkpoint = self.path / 'checkpoint' / 'checkpoint.safetensors'
        self.best = self.path / 'best'
        self.final = self.path / 'final'
        self.tensorboard = self.path / 'tensorboard'

    def create(self) -> None:
        """
        Make the folder.

        Raises:
            RunError: a run is there already, or the place cannot be written.
        """
        if self.config.exists() or self.checkpoint.exists():
            raise RunError(f'{self.path} holds a run already; resume it or name another folder')
        try:
            self.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(f'{self.path}: {error.strerror}') from None

    def read_record(self) -> dict[str, Any]:
        """Return `run.json`, empty if there is none or it cannot be read."""
        try:
            record = json.loads(self.record.read_text())
        except (OSError, ValueError):
            return {}
        return record if isinstance(record, dict) else {}

    def write_record(self, record: dict[str, Any]) -> None:
        """Write `run.json`."""
        write_text(self.record, json.dumps(record, indent=1) + '\n')


def describe_machine() -> dict[str, Any]:
    """Return code version, machine, library versions and load, for the record of a run."""
    return {
        'code': code_version(),
        'python': platform.python_version(),
        'system': platform.platform(),
        'processor': _processor(),
        'cores': len(os.sched_getaffinity(0)),
        'libraries': {name: _version(name) for name in LIBRARIES},
        'load_average': list(os.getloadavg()),
    }


def code_version() -> str:
    """Return the version of the package and, in a checkout, of the commit."""
    version = _version('carracing_dqn')
    try:
        commit = subprocess.run(
            ['git', 'describe', '--always', '--dirty'], cwd=Path(__file__).parent,
            capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f'{version} ({commit})'


def now() -> str:
    """Return the time of day in UTC, to the second."""
    return datetime.now(timezone.utc).isoformat(timespec='seconds')


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return 'not installed'


def _processor() -> str:
    try:
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
