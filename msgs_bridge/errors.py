# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package, all derived from one base."""


class BridgeError(ValueError):
    """Anything wrong with what came from a topic, a file or a setting."""


class MessageError(BridgeError):
    """A message whose content cannot be used; the text names what and why."""


class SettingsError(BridgeError):
    """A setting that is unknown or out of range; the text names what is accepted."""


class SimulatorError(BridgeError):
    """A simulator that is not there, or that cannot go on; the text names what and why."""
