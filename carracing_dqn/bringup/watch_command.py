# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing watch`: the live graph or a bag on one screen, in the terminal or in the browser."""
from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time

from carracing_dqn.watch.source import Source
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from msgs_bridge.terminal import say
from rich.console import Console

PORT = 8787
NICE = 10
"""Who drives comes first."""
MAX_SECONDS = 3600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing watch`."""
    parser.add_argument('bag', nargs='?', default=None,
                        help='a bag to play; without it the graph that runs')
    parser.add_argument('--browser', action='store_true',
                        help='serve a page on this machine instead of a screen in the terminal')
    parser.add_argument('--port', type=int, default=None,
                        help=f'of the page; 0 takes a free one (default {PORT})')
    parser.add_argument('--paused', action='store_true', help='begin a bag paused')
    parser.add_argument('--json', type=float, default=None, metavar='SECONDS',
                        help='watch for so long, then print everything as JSON')


def main(arguments: argparse.Namespace) -> int:
    """Show it until the user ends it; return the exit code."""
    port = PORT if arguments.port is None else arguments.port
    if not 0 <= port < 65536:
        raise BridgeError(f'--port is {port}; accepted: 0 to 65535')
    if arguments.json is not None and arguments.browser:
        raise BridgeError('--json prints and --browser serves a page; leave one of them out')
    if arguments.port is not None and not arguments.browser:
        raise BridgeError('--port is that of the page, which --browser serves')
    if arguments.paused and arguments.bag is None:
        raise BridgeError('--paused is for a bag; the graph is paused by ~/pause of its simulator')
    if arguments.json is not None and not 0.1 <= arguments.json <= MAX_SECONDS:
        raise BridgeError(f'--json is {arguments.json:g}; accepted: 0.1 to {MAX_SECONDS:g} s')
    if arguments.json is None and not arguments.browser and not sys.stdout.isatty():
        raise BridgeError('a screen needs a terminal; --browser serves a page, --json prints')
    os.nice(NICE)
    if arguments.json is None and not arguments.browser:
        say(Console(), f'carracing watch: looking at {plain(arguments.bag or "the graph")}')
    source = _source(arguments)
    try:
        if arguments.json is not None:
            time.sleep(arguments.json)
            sys.stdout.write(json.dumps(source.state.snapshot(source.now()), indent=1) + '\n')
        elif arguments.browser:
            _serve(source, port)
        else:
            # a screen needs a second to load, a page does not need it
            from carracing_dqn.watch.screen import Screen
            Screen(source).run()
    finally:
        source.close()
    return 0


def _source(arguments: argparse.Namespace) -> Source:
    if arguments.bag is not None:
        from carracing_dqn.watch.bag_source import BagSource
        return BagSource(arguments.bag, paused=arguments.paused)
    from carracing_dqn.watch.live_node import LiveSource
    return LiveSource(domain=os.environ.get('ROS_DOMAIN_ID', ''))


def _serve(source: Source, port: int) -> None:
    from carracing_dqn.watch.page import Page
    page = Page(source, port)
    try:
        say(Console(), f'{page.url}  (Ctrl-C ends it)')
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
