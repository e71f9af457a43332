# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch simulator and policy: the car drives."""
from carracing_dqn.bringup.graph import driving_graph
from carracing_dqn.bringup.launch_graph import launch_actions
from carracing_dqn.simulation.profiles import profile_of
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration


def nodes(context: object) -> list:
    """Return what starts the nodes, as the arguments say."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    return launch_actions(driving_graph(
        model=value('model'), seed=int(value('seed')), stepping=value('stepping'),
        action_repeat=int(value('action_repeat')), simulator=value('simulator'),
        policy=profile_of(value('simulator')).vehicle), value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
        DeclareLaunchArgument('simulator', default_value='carracing',
                              description='what to drive in: a name or a profile'),
        DeclareLaunchArgument('model', default_value='racing',
                              description='model folder, name of a shipped model, or random'),
        DeclareLaunchArgument('stepping', default_value='real_time',
                              description='lockstep or real_time'),
        DeclareLaunchArgument('action_repeat', default_value='1',
                              description='simulator frames per published frame'),
        DeclareLaunchArgument('seed', default_value='420',
                              description='seed of the first track; the next ones count up'),
        OpaqueFunction(function=nodes),
    ])
