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
from carracing_dqn.evaluation.validator import validate
from carracing_dqn.simulation import open_drive
from msgs_bridge.transitions import Transition
from trainer_node.hyperparameters import load_preset
from trainer_node.open_run import read_overrides
from trainer_node.training import Training


def learn(
    training: Training, *, minutes: float, report: Callable[[dict[str, float]], None],
    validating: bool = True,
) -> None:
    """
    Drive and learn until the run is complete or the time is over.

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
    started = reported = time.monotonic()
    frame = None
    while not training.complete and time.monotonic() - started < minutes * 60:
        if training.weights_due():
            update = decode_weights(training.weights_message(), training.description)
            policy.swap_weights(update)
            if update.validate and validating:
                judge = Policy(training.description)
                judge.swap_weights(update)
                first = settings.validation_seed
                training.record_validation(validate(
                    judge, range(first, first + settings.validation_tracks),
                    version=update.version))
                report(training.status())
        if frame is None or frame.step.ended:
            frame = drive.begin()
            policy.reset()
        before = frame
        command = policy.decide(before.pixels).command
        frame = drive.advance(command, before.stamp)
        training.add(Transition(
            before.stamp, frame.stamp, before.pixels, frame.pixels, command,
            frame.step, before.step))
        if training.checkpoint_due():
            training.save()
        if time.monotonic() - reported > 10:
            reported = time.monotonic()
            report(training.status())


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
    overrides = read_overrides(args.set)

    def report(status: dict[str, float]) -> None:
        sys.stdout.write(json.dumps({
            name: float(f'{value:.5g}') for name, value in status.items()}) + '\n')
        sys.stdout.flush()

    if args.resume:
        training = Training.resume(args.run)
    else:
        training = Training.create(load_preset(args.preset, overrides), args.run)
    try:
        learn(training, minutes=args.minutes, report=report)
    finally:
        training.finish()
    return 0


if __name__ == '__main__':
    sys.exit(main())
