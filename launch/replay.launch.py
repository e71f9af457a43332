# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch a bag as if the graph were running."""
from carracing_dqn.bringup.graph import replay_graph
from carracing_dqn.bringup.launch_graph import launch_actions
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration


def nodes(context: object) -> list:
    """Return what starts the player, as the arguments say."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    return launch_actions(
        replay_graph(bag=value('bag'), rate=float(value('rate'))), value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
        DeclareLaunchArgument('bag', default_value='', description='bag folder to play'),
        DeclareLaunchArgument('rate', default_value='1.0',
                              description='speed against the recorded pace'),
        OpaqueFunction(function=nodes),
    ])
