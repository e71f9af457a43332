# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing doctor`: what of the machine and of the graph is not as it should be, and a cure."""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import os
import time

from carracing_dqn.bringup.findings_table import findings_table
from carracing_dqn.bringup.machine_checks import machine_findings
from carracing_dqn.simulation.fit import BAD, Finding, GOOD, UNSURE
from msgs_bridge.errors import BridgeError
from msgs_bridge.terminal import say
from rich.console import Console

# Fast DDS announces itself every 3 s, and one announcement may get lost
DISCOVERY_SECONDS = 8.0
LEAST_SECONDS, MOST_SECONDS = 1.0, 600.0
LISTEN_SECONDS = 10.0
WARNING = 'warning'
# what of the machine keeps a node from joining any graph
HOPELESS = ('ROS', 'domain', 'discovery', 'home')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing doctor`."""
    parser.add_argument('--seconds', type=float, default=LISTEN_SECONDS,
                        help='how long to look at the graph (default %(default)s)')


def main(arguments: argparse.Namespace) -> int:
    """Look, and print what was found; return 0, or 1 if something is wrong."""
    if not LEAST_SECONDS <= arguments.seconds <= MOST_SECONDS:
        raise BridgeError(f'--seconds is {arguments.seconds:g}; accepted: {LEAST_SECONDS:g} to '
                          f'{MOST_SECONDS:g}')
    console = Console()
    found = list(machine_findings())
    if not any(one.verdict == BAD and one.name in HOPELESS for one in found):
        say(console, f'looking at the graph for {arguments.seconds:g} s')
        found += _graph_findings(console, arguments.seconds)
    console.print(findings_table(found))
    return int(any(one.verdict == BAD for one in found))


def _graph_findings(console: Console, seconds: float) -> Iterator[Finding]:
    """Yield what was found of discovery and of the nodes that run; show their topics."""
    # rclpy takes a second to load
    from carracing_dqn.watch import painting
    from carracing_dqn.watch.live_node import LiveSource
    from msgs_bridge.listening_node import ListeningNode
    source = LiveSource(domain=os.environ.get('ROS_DOMAIN_ID', ''))
    # of another participant, as if it were another process
    probe = ListeningNode('carracing_doctor')
    try:
        began = time.monotonic()
        while '/carracing_doctor' not in source.state.nodes and (
                time.monotonic() - began < DISCOVERY_SECONDS):
            time.sleep(0.05)
        took = time.monotonic() - began
        there = '/carracing_doctor' in source.state.nodes
        probe.close()
        if not there:
            yield Finding('nodes find', BAD, f'no other node was found in {took:.0f} s',
                          'ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, a profile of the '
                          'middleware, a firewall')
            return
        yield Finding('nodes find', GOOD, f'another node after {took:.1f} s')
        time.sleep(seconds)
        shown = source.state.snapshot(source.now())
    finally:
        source.close()
    nodes = [node for node in shown['nodes'] if node['name'] != '/carracing_doctor']
    if not nodes:
        yield Finding('graph', UNSURE, 'no node runs here',
                      'carracing run; the same ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE '
                      'for both')
        return
    console.print(painting.nodes({'nodes': nodes}))
    console.print(painting.topics(shown))
    yield Finding('graph', GOOD, f'{len(nodes)} nodes, {len(shown["topics"])} topics')
    for node in nodes:
        for name, value in node['values'].items():
            if name.startswith('rejected_') and value not in ('0', ''):
                yield Finding(node['name'], UNSURE, f'{value} messages refused of '
                              f'{name.removeprefix("rejected_")}', node['summary'])
    for cause in shown['causes']:
        if cause['where'] != '/carracing_doctor':
            yield Finding(cause['where'], UNSURE if cause['kind'] == WARNING else BAD,
                          f'{cause["kind"]}: {cause["text"]}', cause['mend'])
