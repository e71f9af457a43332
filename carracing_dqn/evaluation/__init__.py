# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Greedy laps, statistics, figures and the report page; only `node` imports rclpy."""
from __future__ import annotations

from msgs_bridge.lazy_names import lazy_names

# imported on first use, because gymnasium and matplotlib take their time to load
_PLACES = {
    'EvaluationError': 'errors',
    'Lap': 'laps',
    'PolicySource': 'policies',
    'Statistics': 'statistics',
    'drive_lap': 'laps',
    'drive_laps': 'lap_series',
    'lap_picture': 'lap_picture',
    'load_run': 'records',
    'statistics_of': 'statistics',
    'validate': 'validator',
}

__all__ = list(_PLACES)

__getattr__ = lazy_names(__name__, _PLACES)
