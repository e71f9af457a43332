# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of validation_node, each described once."""
from __future__ import annotations

import dataclasses

from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class ValidationSettings:
    """What can be set on the validation node."""

    simulator: str = setting(
        'carracing', 'which simulator to drive in: the name of an installed one, or module:Class')
    seed: int = setting(
        420, 'seed of the first validation track (seed document 3.1); the next ones count up',
        low=0, high=2**31 - 1)
    tracks: int = setting(5, 'laps of a validation (seed document 3.1)', low=1, high=1000)
