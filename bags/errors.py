# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the bags."""
from __future__ import annotations

from msgs_bridge.errors import BridgeError


class BagError(BridgeError):
    """A bag that cannot be read or written; the text names the file and what is wrong."""
