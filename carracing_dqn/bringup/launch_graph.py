# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A graph as actions of ROS launch, for the launch files.

It needs `launch` and `launch_ros`, which come with an installed ROS 2 and are no wheels.
"""
from __future__ import annotations

from carracing_dqn.bringup.graph import Graph
from launch import Action, LaunchContext
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


class NodeFailed(RuntimeError):
    """A node ended with another code than 0, which ends the launch with code 1."""


def launch_actions(graph: Graph, namespace: str) -> list[Action]:
    """
    Return what starts the nodes of a graph, and ends them all when one of them ends.

    Args:
        graph: the nodes, in the order in which they start.
        namespace: their ROS namespace; empty for none.
    """
    nodes = [
        Node(
            package='carracing_dqn', executable=node.kind.name, namespace=namespace,
            output='screen', prefix=f'nice -n {node.kind.nice}' if node.kind.nice else None,
            # with a type, because launch reads a text like 2026 as YAML otherwise
            parameters=[{name: ParameterValue(value, value_type=type(value))
                         for name, value in node.parameters.items()}])
        for node in graph]
    return [RegisterEventHandler(OnProcessExit(on_exit=_end_all)), *nodes]


def _end_all(event: ProcessExited, context: LaunchContext) -> EmitEvent | None:
    if context.is_shutdown:
        return None
    if event.returncode:
        raise NodeFailed(f'{event.process_name} ended with code {event.returncode}')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} is done'))
