# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""CarRacing-v3, equal to gymnasium's to the byte and several times faster."""
from __future__ import annotations

from msgs_bridge.lazy_names import lazy_names

# imported on first use, because gymnasium takes a second to load
_PLACES = {
    'CarRacingEnvironment': 'environment',
    'EpisodeError': 'errors',
    'Facts': 'facts',
    'InvalidActionError': 'errors',
    'InvalidVariantError': 'errors',
    'RendererUnavailableError': 'errors',
    'RendererWarning': 'renderer',
    'SimulatorError': 'errors',
    'make_env': 'environment',
}

__all__ = list(_PLACES)

__getattr__ = lazy_names(__name__, _PLACES)
