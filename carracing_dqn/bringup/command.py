# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing`: one command that starts the nodes and everything around them."""
from __future__ import annotations

import argparse
import importlib
import sys

from msgs_bridge.errors import BridgeError

SUBCOMMANDS = {
    'run': ('carracing_dqn.bringup.run_command',
            'drive laps with the shipped model and record a bag'),
    'train': ('carracing_dqn.bringup.train_command',
              'the whole learning graph, validation included'),
    'evaluate': ('carracing_dqn.bringup.evaluate_command',
                 'greedy laps on seeded tracks in the unmodified environment'),
    'report': ('carracing_dqn.evaluation.report_command',
               'figures and tables of the seed document from a run'),
    'bag': ('bags.command', 'record, play, info, verify, recover and export MCAP bags'),
    'bench': ('carracing_dqn.bringup.bench_command', "benchmarks, each figure beside its peer's"),
}


def main(words: list[str] | None = None) -> int:
    """Run a subcommand; return the exit code. Errors are one line on stderr and code 2."""
    words = sys.argv[1:] if words is None else words
    parser = argparse.ArgumentParser(prog='carracing', description=__doc__)
    subparsers = parser.add_subparsers(dest='subcommand', metavar='COMMAND', required=True)
    for name, (module_name, text) in SUBCOMMANDS.items():
        subparser = subparsers.add_parser(name, help=text, description=text)
        # only the module that is asked for is imported: torch alone takes seconds
        if words[:1] == [name]:
            module = importlib.import_module(module_name)
            module.add_arguments(subparser)
    arguments = parser.parse_args(words)
    try:
        return module.main(arguments)
    except BridgeError as error:
        sys.stderr.write(f'error: {error}\n')
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == '__main__':
    sys.exit(main())
