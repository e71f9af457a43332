# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The learning loop in one process, without ROS: the baseline that the graph is measured against.

It does the same work with the same classes: environment, policy, training. Also the quickest way
to try a recipe:

    python -m carracing_dqn.benchmarks.single_process_loop --preset racing --run runs/try
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import sys
import time

from dqn_policy_node.policy import Policy
from dqn_policy_node.weights_message import decode_weights
from carracing_dqn.evaluation.validator import validate_weights
from carracing_dqn.simulation import open_drive
from msgs_bridge.transitions import Transition
from trainer_node.driver import Driver
from trainer_node.open_run import open_training, read_overrides, run_settings
from trainer_node.training import Training

REPORT_SECONDS = 10.0


def learn(
    training: Training, *, minutes: float, report: Callable[[dict[str, float]], None],
    validating: bool = True,
) -> None:
    """
    Drive and learn until the run is complete or the time is over, and save it.

    Args:
        training: the run.
        minutes: most wall-clock minutes for this call.
        report: takes the figures of the moment every ten seconds and at validations.
        validating: whether to drive validations in this process when they are due.
    """
    settings = training.settings
    drive = open_drive({
        **settings.simulator_parameters(), 'first_episode': training.episodes})
    policy = Policy(training.description, seed=settings.seed)
    policy.action_repeat = settings.action_repeat

    def publish(data: bytes) -> dict[str, float] | None:
        policy.swap_weights(decode_weights(data, training.description))
        return validate_weights(
            data, settings.validation_seeds, settings.simulator) if validating else None

    driver = Driver(training, publish)
    started = reported = time.monotonic()
    frame = None
    try:
        while driver.turn() and time.monotonic() - started < minutes * 60:
            if frame is None or frame.step.ended:
                frame = drive.begin()
                policy.reset()
            before = frame
            command = policy.decide(before.pixels).command
            frame = drive.advance(command, before.stamp)
            driver.add(Transition(
                before.stamp, frame.stamp, before.pixels, frame.pixels, command,
                frame.step, before.step))
            if time.monotonic() - reported > REPORT_SECONDS:
                reported = time.monotonic()
                report(training.status())
    finally:
        driver.end()
        if not training.failed:
            driver.close()


def main(argv: list[str] | None = None) -> int:
    """Run the loop from the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--preset', default='racing', help='preset name or file')
    parser.add_argument('--run', type=Path, required=True, help='run folder')
    parser.add_argument('--minutes', type=float, default=60.0, help='wall-clock limit')
    parser.add_argument('--resume', action='store_true', help='go on from the checkpoint')
    parser.add_argument('--set', nargs='*', action='extend', default=[], metavar='NAME=VALUE',
                        help='hyperparameters that differ from the preset')
    args = parser.parse_args(argv)

    def report(status: dict[str, float]) -> None:
        sys.stdout.write(json.dumps({
            name: float(f'{value:.5g}') for name, value in status.items()}) + '\n')
        sys.stdout.flush()

    settings = run_settings(
        args.run, args.preset, read_overrides(args.set), resume=args.resume)
    learn(open_training(args.run, settings, resume=args.resume), minutes=args.minutes,
          report=report)
    return 0


if __name__ == '__main__':
    sys.exit(main())
