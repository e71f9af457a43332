# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a node that the `carracing` command has started does before it is itself.

`python -m carracing_dqn.bringup.child --parent PID OPTIONS -m MODULE WORDS...` runs the `main` of
a module. All of this happens in the child, because code between fork and exec of a
parent with threads may hang.
"""
from __future__ import annotations

import argparse
import contextlib
import ctypes
import importlib
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def end_with_parent(parent: int) -> None:
    """Ask the kernel (Linux) for SIGTERM when the parent is gone, however it goes."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        # it was gone before the kernel could be asked
        sys.exit(1)


def main() -> int:
    """Become the node; return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument('--parent', type=int, required=True, help='process to end with')
    parser.add_argument('--nice', type=int, default=0, help='added to the niceness')
    parser.add_argument('--folder', default='.', help='current folder of the node')
    parser.add_argument('--supervised', action='store_true',
                        help='end otherwise when stopped by a signal than with finished work, and '
                             'with 0 in neither case')
    parser.add_argument('-m', dest='module', required=True,
                        help='module with a main, or package with a node')
    # what follows the module is the node's own
    ours = sys.argv.index('-m') + 2 if '-m' in sys.argv else len(sys.argv)
    arguments, words = parser.parse_args(sys.argv[1:ours]), sys.argv[ours:]
    # a node that is stopped while it still imports has nothing to save and nothing to say
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    end_with_parent(arguments.parent)
    os.nice(arguments.nice)
    module = importlib.import_module(arguments.module)
    if hasattr(module, '__path__'):
        # as its __main__ does
        module = importlib.import_module(f'{arguments.module}.node')
    from msgs_bridge.exit_codes import FINISHED, INTERRUPTED
    from msgs_bridge.node_process import STARTED
    if arguments.supervised:
        STARTED.finished_code, STARTED.stopped_code = FINISHED, INTERRUPTED
    # only now, so that a relative place of the modules still holds while they are imported
    os.chdir(arguments.folder)
    sys.argv = [arguments.module, *words]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return module.main() or 0
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == '__main__':
    sys.exit(main())
