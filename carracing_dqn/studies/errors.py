# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package."""
from msgs_bridge.errors import BridgeError


class StudyError(BridgeError):
    """A study that cannot be read or run; the text names what and why."""
