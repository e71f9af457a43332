# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing view`: a bag or the live graph in Rerun."""
from __future__ import annotations

import argparse
import importlib.util
import os
from pathlib import Path

from bags.reader import BagReader
from msgs_bridge.errors import BridgeError
from msgs_bridge.listening_node import absolute_namespace
from msgs_bridge.terminal import say
from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing view`."""
    parser.add_argument('bag', nargs='?', default=None, help='folder or single file')
    parser.add_argument('--live', action='store_true', help='the graph that runs, until Ctrl-C')
    parser.add_argument('--save', default=None, metavar='FILE',
                        help='new .rrd file in place of a window')
    parser.add_argument('--namespace', default='', help='ROS namespace of the car')


def main(arguments: argparse.Namespace) -> int:
    """Show it; return the exit code."""
    if (arguments.bag is None) != arguments.live:
        raise BridgeError('what to view: BAG or --live')
    if importlib.util.find_spec('rerun') is None:
        raise BridgeError("Rerun is not installed: pip install '.[rerun]'; Foxglove and "
                          'PlotJuggler open a bag as it is')
    if arguments.save is not None and Path(arguments.save).exists():
        raise BridgeError(f'{arguments.save} exists already; nothing was overwritten')
    namespace = absolute_namespace(arguments.namespace)
    if arguments.live:
        return _live(arguments.save, namespace)
    with BagReader(arguments.bag) as reader:
        from carracing_dqn.watch import rerun_view
        shown = rerun_view.show(
            rerun_view.open_view(arguments.save), rerun_view.of_bag(reader, namespace))
    say(Console(), f'{shown} frames' + (f' in {arguments.save}' if arguments.save else ''))
    return 0


def _live(save: str | None, namespace: str) -> int:
    from carracing_dqn.watch import rerun_view
    from carracing_dqn.watch.live_node import LiveSource
    source = LiveSource(domain=os.environ.get('ROS_DOMAIN_ID', ''))
    try:
        rerun_view.show(rerun_view.open_view(save), rerun_view.of_graph(
            source, namespace or None))
    except KeyboardInterrupt:
        pass
    finally:
        source.close()
    return 0
