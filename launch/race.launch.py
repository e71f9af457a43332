# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch simulator and policy: the car drives."""
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
        DeclareLaunchArgument('model', default_value='racing',
                              description='model folder, name of a shipped model, or random'),
        DeclareLaunchArgument('stepping', default_value='real_time',
                              description='lockstep or real_time'),
        DeclareLaunchArgument('action_repeat', default_value='1',
                              description='simulator frames per published frame'),
        DeclareLaunchArgument('seed', default_value='420',
                              description='seed of the first track'),
        Node(package='carracing_dqn', executable='carracing_sim_node',
             namespace=value('namespace'),
             output='screen', parameters=[{
                 'stepping': value('stepping'),
                 'action_repeat': value('action_repeat'),
                 'seed': value('seed'),
             }]),
        Node(package='carracing_dqn', executable='dqn_policy_node', namespace=value('namespace'),
             output='screen', parameters=[{
                 'model': value('model'),
             }]),
    ])
