# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: versions and parameters, as JSON for its bag."""
from __future__ import annotations

from importlib import metadata
import json
import platform

LIBRARIES = ('carracing_dqn', 'gymnasium', 'pygame-ce', 'box2d', 'numpy', 'torch')


def library_versions() -> dict[str, str]:
    """Return the installed versions of what decides pixels and numbers."""
    versions = {'python': platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def provenance_text(**parameters: dict[str, object]) -> str:
    """Return versions and the parameters of each node as a JSON object."""
    return json.dumps({'versions': library_versions(), **parameters}, sort_keys=True)
