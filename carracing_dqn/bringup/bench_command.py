# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing bench`: hands on to the benchmarks."""
from __future__ import annotations

import argparse
import importlib

BENCHMARKS = (
    'sim', 'graph', 'learner', 'bags', 'cars', 'pyracerz', 'robustness', 'watch',
    'demonstrations', 'transport')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing bench`."""
    parser.add_argument('benchmark', choices=BENCHMARKS, help='what to measure')
    parser.add_argument('options', nargs=argparse.REMAINDER,
                        help='options of that benchmark, --help among them')


def main(arguments: argparse.Namespace) -> int:
    """Run one benchmark; return its exit code."""
    module = importlib.import_module(f'carracing_dqn.benchmarks.bench_{arguments.benchmark}')
    return module.main(arguments.options) or 0
