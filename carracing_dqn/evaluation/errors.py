# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package."""
from msgs_bridge.errors import BridgeError


class EvaluationError(BridgeError):
    """Anything that keeps laps from being driven or reported; the text names what and why."""


class PolicyError(EvaluationError):
    """A policy that cannot be opened, or an action that is none."""


class ResultsError(EvaluationError):
    """A results file that cannot be read, or that belongs to another evaluation."""


class RecordsError(EvaluationError):
    """A run folder in which there is nothing to report."""
