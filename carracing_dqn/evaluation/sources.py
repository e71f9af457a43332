# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files that laps depend on and that their owner may change: of policies, of simulators."""
from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

from carracing_dqn.simulation.profiles import find_profile


def simulator_source(name: str) -> str:
    """Return the hash of the profile or the module that a simulator is named by, '' for none."""
    path = find_profile(name)
    if path is not None:
        return _sha256(path)
    return module_source(name.partition(':')[0]) if ':' in name else ''


def module_source(name: str) -> str:
    """Return the hash of the file of a module that is imported or could be, '' without one."""
    try:
        found = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return ''
    return '' if found is None or not found.origin else _sha256(Path(found.origin))


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        # built in, or out of an archive
        return ''
