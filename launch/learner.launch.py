# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch trainer and validator, for cars that come and go on any host."""
from carracing_dqn.bringup.graph import learner_graph
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
    return launch_actions(learner_graph(
        settings, cars=int(value('cars')), vehicle=profile_of(settings.simulator).vehicle,
        trainer={'run': value('run'), 'preset': value('preset')}), value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
        DeclareLaunchArgument('preset', default_value='racing',
                              description='racing, report, or the path of a YAML file'),
        DeclareLaunchArgument('cars', default_value='8',
                              description='cars that are counted on, for the spread of epsilon'),
        DeclareLaunchArgument('run', default_value='runs/launched',
                              description='run folder, which must not hold a run yet'),
        OpaqueFunction(function=nodes),
    ])
