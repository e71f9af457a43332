# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A graph from its start to its end: what may go wrong meanwhile ends it with one line."""
from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import os
from pathlib import Path
import resource
import time

from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.graph import Graph
from carracing_dqn.bringup.monitor import Monitor
from carracing_dqn.bringup.processes import ProcessGroup
from msgs_bridge.errors import BridgeError
from msgs_bridge.file_lock import lock
from msgs_bridge.private_folder import make_temporary

LOOK_SECONDS = 0.1

FIRST_LOOK_SECONDS = 1.0
"""How long a simulator that runs already is looked for, before ours starts."""

UNHEARD_SECONDS = 20.0
"""How long nodes may run without one of them being heard: discovery takes 0.1 to 6 s."""

RUNS_ALREADY = ('a simulator runs on this ROS domain already; stop it, or use --namespace or '
                'another ROS_DOMAIN_ID')

MIN_FILES = 64
"""File descriptors with which a graph was seen to drive; some of DDS' sockets need one each."""


# places on the ROS domains of this host where this process has a graph
_taken: dict[Path, int] = {}


def check_machine() -> None:
    """
    Look for what nodes need of a machine, before any is started.

    Raises:
        BridgeError: something is missing; the text says what to do.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < MIN_FILES != resource.RLIM_INFINITY:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, MIN_FILES), hard))
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if soft < MIN_FILES:
            raise BridgeError(f'{soft} open files are allowed (ulimit -n); a graph needs '
                              f'{MIN_FILES} or more')


def refuse_second_simulator(monitor: Monitor, spaces: Sequence[str] = ('',)) -> None:
    """
    Look for a simulator that runs already: two would both answer to the same twists.

    Args:
        monitor: looks.
        spaces: the namespaces of the new ones below that of the graph; none: one in that itself.

    Raises:
        BridgeError: there is one, or another command is about to start one.
    """
    for space in spaces or ('',):
        _take_place(f'{monitor.state.namespace}/{space}')
    deadline = time.monotonic() + FIRST_LOOK_SECONDS
    while time.monotonic() < deadline:
        if any(map(monitor.simulators, spaces or ('',))):
            raise BridgeError(RUNS_ALREADY)
        time.sleep(LOOK_SECONDS)


def _take_place(space: str) -> None:
    """
    Take a namespace of this ROS domain, until the graph ends, from other commands of this user.

    Two that are started in the same second see no simulator of the other yet. Where there is no
    room for a lock, looking has to do.

    Raises:
        BridgeError: another one has it.
    """
    try:
        # hosts that share their temporary files have networks of their own
        network = os.stat('/proc/self/ns/net').st_ino
        domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
        name = f'{network}-{domain}{space.rstrip("/").replace("/", "-")}.lock'
        place = make_temporary('carracing_graphs') / name
        if place in _taken:
            return
        handle = os.open(place, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:
        return
    if lock(handle, BridgeError(RUNS_ALREADY)):
        _taken[place] = handle
    else:
        os.close(handle)


def _leave_places() -> None:
    """Let other commands have what this process has taken."""
    while _taken:
        os.close(_taken.popitem()[1])


def look(group: ProcessGroup, monitor: Monitor) -> str | None:
    """
    Return the name of a node that has finished its work, None while all are at it.

    Raises:
        BridgeError: a node ended before its work was done, the run folder is gone, or the nodes
            run but cannot be heard.
    """
    finished = group.check()
    if finished is None and not monitor.state.health and group.up_for() > UNHEARD_SECONDS:
        raise BridgeError(
            f'the nodes run, but none of them was heard in {UNHEARD_SECONDS:g} s: DDS discovery '
            'does not work here; look at ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_DOMAIN_ID, a '
            f'firewall, a profile of the middleware, and the logs in {group.log_folder}')
    return finished


def run_to_the_end(
    graph: Graph, *, namespace: str, folder: Path, monitor: Monitor, display: Display,
    settled: Callable[[], bool] = lambda: True, over: Callable[[], bool] = lambda: False,
) -> bool:
    """
    Run a graph until a node of it has finished its work; return whether the user stopped it.

    Args:
        graph: the nodes; paths in their parameters count from `folder`.
        namespace: ROS namespace; empty for none.
        folder: run folder with `log` in it.
        monitor: hears the nodes.
        display: shows how far they are.
        over: asked all the time whether to end though no node has finished.
        settled: asked after the end, for at most a second, whether all results have come.

    Raises:
        BridgeError: as `look`; or a node could not save what it had to.
    """
    interrupted = False
    with ProcessGroup(folder / 'log') as group:
        try:
            group.start_graph(graph, namespace, folder)
            with display:
                while look(group, monitor) is None and not over():
                    for line in group.losses():
                        display.say(line)
                    display.update()
                    time.sleep(LOOK_SECONDS)
                deadline = time.monotonic() + 1.0
                while not settled() and time.monotonic() < deadline:
                    time.sleep(LOOK_SECONDS / 2)
        except KeyboardInterrupt:
            interrupted = True
            display.say('stopping')
        finally:
            group.stop()
            _leave_places()
        group.check_ends()
    display.finish()
    return interrupted
