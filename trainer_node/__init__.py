# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From transitions to better weights: replay, learner, schedules, checkpoints, tracking."""
from __future__ import annotations

import importlib
from typing import Any

# imported on first use, because torch takes a second to load
_PLACES = {
    'Hyperparameters': 'hyperparameters',
    'LearningError': 'errors',
    'RunError': 'errors',
    'Training': 'training',
    'load_preset': 'hyperparameters',
}

__all__ = list(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(importlib.import_module(f'{__name__}.{_PLACES[name]}'), name)
