# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From transitions to better weights: replay, learner, schedules, checkpoints, tracking."""
from __future__ import annotations

from msgs_bridge.lazy_names import lazy_names

# imported on first use, because torch takes a second to load
_PLACES = {
    'Hyperparameters': 'hyperparameters',
    'LearningError': 'errors',
    'RunError': 'errors',
    'Training': 'training',
    'load_preset': 'hyperparameters',
}

__all__ = list(_PLACES)

__getattr__ = lazy_names(__name__, _PLACES)
