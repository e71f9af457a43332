# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The two simulators laps are driven in: gymnasium's own, and ours that equals it to the byte."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from carracing_sim_node import make_env
from carracing_dqn.evaluation.errors import EvaluationError
import gymnasium

GYMNASIUM_ID = 'CarRacing-v3'


def _gymnasium() -> gymnasium.Env:
    return gymnasium.make(GYMNASIUM_ID)


SIMULATORS: dict[str, Callable[[], gymnasium.Env]] = {'gymnasium': _gymnasium, 'fast': make_env}
"""Name -> what makes one: the unmodified environment, or the fast one with equal frames."""


def make_simulator(name: str) -> gymnasium.Env:
    """
    Make the environment of a name.

    Raises:
        EvaluationError: there is no such simulator.
    """
    if name not in SIMULATORS:
        raise EvaluationError(f'simulator is {name!r}; accepted: {", ".join(SIMULATORS)}')
    return SIMULATORS[name]()


def world_of(env: gymnasium.Env) -> Any:
    """Return gymnasium's CarRacing object (car, track, tiles) behind either environment."""
    return getattr(env.unwrapped, 'simulation', env.unwrapped)


def draws_on_request(env: gymnasium.Env) -> bool:
    """Return whether `step` takes `draw=False`, which leaves physics and reward as they are."""
    return hasattr(env.unwrapped, 'simulation')
