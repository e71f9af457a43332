# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From image to twist: network, preprocessing, action spaces and model folders."""
from __future__ import annotations

from msgs_bridge.lazy_names import lazy_names

# imported on first use, because torch takes a second to load
_PLACES = {
    'ACTION_SPACES': 'action_space',
    'ModelDescription': 'model_description',
    'ModelError': 'errors',
    'Policy': 'policy',
    'RandomPolicy': 'policy',
    'find_model': 'shipped_models',
    'load_policy': 'policy',
}

__all__ = list(_PLACES)

__getattr__ = lazy_names(__name__, _PLACES)
