# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch one car, simulator and policy, for a trainer that was started by learner.launch.py."""
from carracing_dqn.bringup.graph import one_of_the_cars
from carracing_dqn.bringup.launch_graph import launch_actions
from carracing_dqn.simulation.profiles import profile_of
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from trainer_node.hyperparameters import load_preset


def nodes(context: object) -> list:
    """Return what starts the nodes, set up as the preset says."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    settings = load_preset(value('preset'))
    return launch_actions(one_of_the_cars(
        settings, int(value('car')), int(value('cars')),
        first_episode=int(value('first_episode')),
        vehicle=profile_of(settings.simulator).vehicle), value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of the trainer'),
        DeclareLaunchArgument('preset', default_value='racing',
                              description='the same as of the trainer'),
        DeclareLaunchArgument('car', description='number of this car, from 0; each has its own'),
        DeclareLaunchArgument('cars', default_value='8',
                              description='the same as of the trainer'),
        DeclareLaunchArgument('first_episode', default_value='0',
                              description='episodes that this car has driven before'),
        OpaqueFunction(function=nodes),
    ])
