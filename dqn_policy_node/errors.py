# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the policy."""
from msgs_bridge.errors import BridgeError


class ModelError(BridgeError):
    """A model folder, description or weights image that cannot be used; the text says why."""
