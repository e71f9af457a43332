# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A graph as actions of ROS launch, for the launch files."""
from __future__ import annotations

from typing import Any

from carracing_dqn.bringup.graph import Graph


class NodeFailed(RuntimeError):
    """A node ended with another code than 0, which ends the launch with code 1."""


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
    nodes = [
        Node(
            package='carracing_dqn', executable=node.kind.name,
            namespace=node.namespace(namespace), remappings=list(node.remaps(namespace).items()),
            output='screen', prefix=f'nice -n {node.kind.nice}' if node.kind.nice else None,
            # with a type, because launch reads a text like 2026 as YAML otherwise
            parameters=[{name: ParameterValue(value, value_type=type(value))
                         for name, value in node.parameters.items()}])
        for node in graph]
    return [RegisterEventHandler(OnProcessExit(on_exit=_end_all)), *nodes]


def _end_all(event: Any, context: Any) -> Any:
    """End the launch with the first node that ends, and with code 1 if that one has failed."""
    from launch.actions import EmitEvent
    from launch.events import Shutdown
    if context.is_shutdown:
        return None
    if event.returncode:
        raise NodeFailed(f'{event.process_name} ended with code {event.returncode}')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} is done'))
