# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What action spaces of every kind are held to; their descriptions come from outside."""
from __future__ import annotations

from collections.abc import Sequence

from dqn_policy_node.errors import ModelError

MAX_OUTPUTS = 64
MAX_NAME = 80
# a twist that went through float32 is off by less than 1e-7; neighbours differ by 0.05 or more
TOLERANCE = 0.01


def check_names(names: Sequence[str]) -> None:
    """Check the names of outputs; raises ModelError."""
    if not 1 <= len(names) <= MAX_OUTPUTS:
        raise ModelError(f'{len(names)} actions; accepted: 1 to {MAX_OUTPUTS}')
    if len(set(names)) != len(names):
        raise ModelError('every action needs a name of its own')


def check_text(*texts: object) -> None:
    """Check names that come from outside; raises ModelError."""
    if not all(isinstance(text, str) and 0 < len(text) <= MAX_NAME for text in texts):
        raise ModelError(f'names of actions must be texts of 1 to {MAX_NAME} characters')


def check_range(name: str, values: Sequence[float]) -> None:
    """Check numbers of commands; raises ModelError."""
    # written so that NaN fails: every comparison with it is False
    if not all(-1 <= value <= 1 for value in values):
        raise ModelError(f'action {name!r} is {tuple(values)}; '
                         'accepted: linear and angular from -1 to 1')
