# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A graph as actions of ROS launch, for the launch files."""
from __future__ import annotations

import contextlib
import functools
import os
from typing import Any

from carracing_dqn.bringup.graph import Graph
from msgs_bridge.node_process import FINISHED_TO


class NodeFailed(RuntimeError):
    """A node ended before its work was done, which ends the launch with code 1."""


def launch_actions(graph: Graph, namespace: str) -> list[Any]:
    """
    Return what starts the nodes of a graph, and ends them all when one of them ends.

    Args:
        graph: the nodes, in the order in which they start.
        namespace: their ROS namespace; empty for none.
    """
    # not every ROS has launch, and only launch files come here
    from launch.actions import RegisterEventHandler
    from launch.event_handlers import OnProcessExit
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue
    finished, writer = os.pipe()
    os.set_blocking(finished, False)
    nodes = [
        Node(
            package='carracing_dqn', executable=node.kind.name,
            namespace=node.namespace(namespace), remappings=list(node.remaps(namespace).items()),
            additional_env={FINISHED_TO: f'/proc/{os.getpid()}/fd/{writer}'},
            output='screen', prefix=f'nice -n {node.kind.nice}' if node.kind.nice else None,
            # with a type, because launch reads a text like 2026 as YAML otherwise
            parameters=[{name: ParameterValue(value, value_type=type(value))
                         for name, value in node.parameters.items()}])
        for node in graph]
    return [RegisterEventHandler(OnProcessExit(on_exit=functools.partial(_end_all, finished))),
            *nodes]


def _end_all(finished: int, event: Any, context: Any) -> Any:
    """
    End the launch with the first node that ends, and with code 1 if that one has failed.

    Args:
        finished: pipe with the process ids of the nodes whose work is done.
        event: that one has ended.
        context: of the launch.
    """
    from launch.actions import EmitEvent
    from launch.events import Shutdown
    if context.is_shutdown:
        return None
    if event.returncode:
        raise NodeFailed(f'{event.process_name} ended with code {event.returncode}')
    done = b''
    with contextlib.suppress(BlockingIOError):
        done = os.read(finished, 65536)
    # with 0 any library may end a process at any time
    if f'{event.pid}'.encode() not in done.split():
        raise NodeFailed(f'{event.process_name} ended with code 0 before its work was done')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} is done'))
