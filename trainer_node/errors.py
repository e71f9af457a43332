# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the trainer."""
from msgs_bridge.errors import BridgeError


class RunError(BridgeError):
    """A run folder or checkpoint that cannot be used; the text names it and says why."""


class LearningError(BridgeError):
    """Learning that cannot go on, as when the loss is not finite; the text says where."""
