# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch a bag as if the graph were running."""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    value = LaunchConfiguration
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of all nodes'),
        DeclareLaunchArgument('bag', default_value='',
                              description='bag folder to play'),
        DeclareLaunchArgument('rate', default_value='1.0',
                              description='speed against the recorded pace'),
        Node(package='carracing_dqn', executable='bag_player_node', namespace=value('namespace'),
             output='screen', parameters=[{
                 'bag': value('bag'),
                 'rate': value('rate'),
             }]),
    ])
