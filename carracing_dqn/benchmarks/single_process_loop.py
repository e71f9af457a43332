# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The learning loop in one process, without ROS: the baseline that the graph is measured against.

Also the quickest way to try a recipe:

    python -m carracing_dqn.benchmarks.single_process_loop --preset racing --run runs/try
"""
from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
import time

from carracing_dqn.studies.one_process import learn
from trainer_node.open_run import open_training, read_overrides, run_settings

REPORT_SECONDS = 10.0


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
    started = reported = time.monotonic()

    def report(status: dict[str, float]) -> None:
        nonlocal reported
        if time.monotonic() - reported <= REPORT_SECONDS:
            return
        reported = time.monotonic()
        sys.stdout.write(json.dumps({
            name: float(f'{value:.5g}') for name, value in status.items()}) + '\n')
        sys.stdout.flush()

    settings = run_settings(
        args.run, args.preset, read_overrides(args.set), resume=args.resume)
    learn(open_training(args.run, settings, resume=args.resume), report=report,
          should_stop=lambda: time.monotonic() - started > args.minutes * 60)
    return 0


if __name__ == '__main__':
    sys.exit(main())
