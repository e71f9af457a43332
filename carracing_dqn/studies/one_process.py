# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The learning loop in one process, without ROS.

It does the same work as the graph with the same classes: simulator, policy, training, validation.
What it learns is a function of the settings alone, unless they name a time.
"""
from __future__ import annotations

from collections.abc import Callable

from dqn_policy_node.policy import Policy
from dqn_policy_node.weights_message import decode_weights
from carracing_dqn.evaluation.validator import validate_weights
from carracing_dqn.simulation import open_drive
from carracing_dqn.simulation.profiles import found_from
from msgs_bridge.transitions import Transition
from trainer_node.driver import Driver
from trainer_node.training import Training


def learn(
    training: Training, *, should_stop: Callable[[], bool] = lambda: False,
    report: Callable[[dict[str, float]], None] | None = None, validating: bool = True,
) -> None:
    """
    Drive and learn until the run is complete; then write its final model.

    Args:
        training: the run.
        should_stop: asked before every decision; when it says True the run is left with a
            checkpoint, to be gone on with.
        report: takes the figures of the moment after every decision.
        validating: whether to drive validations in this process when they are due.
    """
    settings = training.settings
    simulator = found_from(settings.simulator, training.folder.path)
    drive = open_drive({
        **settings.simulator_parameters(), 'simulator': simulator,
        'first_episode': training.episodes})
    # a run that goes on explores anew, as that of the graph does
    policy = Policy(training.description, seed=(settings.seed + training.decisions) % 2**31,
                    frame_seconds=drive.simulator.frame_seconds)
    policy.action_repeat = settings.action_repeat

    def publish(data: bytes) -> dict[str, float] | None:
        policy.swap_weights(decode_weights(data, training.description))
        return validate_weights(
            data, settings.validation_seeds, simulator) if validating else None

    driver = Driver(training, publish, last_validation_seconds=bool(
        validating and settings.validates))
    frame = None
    try:
        while driver.turn() and not should_stop():
            if driver.ended or driver.pretraining:
                continue
            if frame is None or frame.step.ended:
                frame = drive.begin()
                policy.reset()
            before = frame
            command = policy.decide(before.pixels).command
            frame = drive.advance(command, before.stamp)
            driver.add(Transition(
                before.stamp, frame.stamp, before.pixels, frame.pixels, command,
                frame.step, before.step))
            if report is not None:
                report(driver.status)
    finally:
        if not training.failed:
            driver.close()
