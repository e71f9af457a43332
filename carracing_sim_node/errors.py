# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The errors of the simulator. Each leaves the environment usable."""

from msgs_bridge.errors import SimulatorError

__all__ = [
    'EpisodeError', 'InvalidActionError', 'InvalidVariantError', 'RendererUnavailableError',
    'SimulatorError',
]


class InvalidActionError(SimulatorError):
    """An action of the wrong shape, not a number, or outside the action space."""


class InvalidVariantError(SimulatorError):
    """A parameter of `make_env` with a value that it does not take."""


class EpisodeError(SimulatorError, RuntimeError):
    """A frame was asked for before `reset`, or after the episode ended."""


class RendererUnavailableError(SimulatorError, RuntimeError):
    """The renderer that was asked for by name cannot run here."""
