# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Validation while training: greedy laps of a policy, in this process."""
from __future__ import annotations

from collections.abc import Callable, Iterable
import time

from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.laps import drive_lap, Lap, Policy
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import make_simulator
from carracing_dqn.simulation.registry import DEFAULT
from msgs_bridge.simulator import Simulator
from dqn_policy_node import policy as dqn_policy
from dqn_policy_node.weights_message import decode_weights
import numpy as np


def validate(
    policy: Policy, seeds: Iterable[int], *, version: int = 0,
    simulator: Simulator | None = None,
    on_lap: Callable[[Lap], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> dict[str, float]:
    """
    Drive one greedy lap a seed; return `step.VALIDATION_FIELDS`.

    From here on torch uses one thread in this process: more gain nothing with one frame at a
    time, and take the cores from the trainer and the simulator.

    Args:
        policy: acts as it is; its `epsilon`, if it has one, should be 0.
        seeds: seeds of the tracks.
        version: version of the weights, passed on.
        simulator: what to drive in; CarRacing if nothing is said.
        on_lap: called after every lap.
        should_stop: asked after every lap; when it says True, the laps so far are returned.

    Raises:
        PolicyError: the policy answered with something that is no action.
        EvaluationError: there was no seed.
    """
    limit_torch_threads()
    started = time.perf_counter()
    laps: list[Lap] = []
    simulator = make_simulator(DEFAULT) if simulator is None else simulator
    for seed in seeds:
        laps.append(drive_lap(simulator, policy, seed))
        if on_lap is not None:
            on_lap(laps[-1])
        if should_stop is not None and should_stop():
            break
    if not laps:
        raise EvaluationError('validation needs at least one seed')
    returns = np.array([lap.episode_return for lap in laps])
    return {
        'version': version,
        'episodes': len(laps),
        'mean': float(returns.mean()),
        'std': float(returns.std()),
        'minimum': float(returns.min()),
        'maximum': float(returns.max()),
        # a simulator that says nothing of laps has none that were completed
        'completed': sum(lap.lap_finished or False for lap in laps) / len(laps),
        'seconds': time.perf_counter() - started,
    }


def validate_weights(
    data: bytes, seeds: Iterable[int], simulator: str = DEFAULT,
) -> dict[str, float] | None:
    """
    Drive a validation of a weights image that asks for one; None if it does not.

    Raises:
        ModelError: the image cannot be used.
        MessageError: the model sees frames of another size.
    """
    update = decode_weights(data)
    if not update.validate:
        return None
    made = make_simulator(simulator)
    policy = dqn_policy.Policy(update.description, frame_seconds=made.frame_seconds)
    policy.swap_weights(update)
    policy.act_greedily()
    return validate(policy, seeds, version=update.version, simulator=made)
