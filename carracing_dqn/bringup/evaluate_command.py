# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing evaluate`: the evaluation's command, given what starts nodes."""
from __future__ import annotations

import argparse

from carracing_dqn.evaluation import evaluate_command


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    evaluate_command.add_arguments(parser)


def main(arguments: argparse.Namespace) -> int:
    """Drive the laps; return the exit code."""
    run_graph = None
    if arguments.through_graph:
        from carracing_dqn.bringup.graph_laps import run_graph
    return evaluate_command.main(arguments, run_graph=run_graph)
