# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch trainer, simulator, policy and validator: the car learns."""
from carracing_dqn.bringup.graph import training_graph
from carracing_dqn.bringup.launch_graph import launch_actions
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from trainer_node.hyperparameters import load_preset


def nodes(context: object) -> list:
    """Return what starts the nodes, set up as the preset says."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    return launch_actions(training_graph(
        load_preset(value('preset')),
        trainer={'run': value('run'), 'preset': value('preset')}), value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
        DeclareLaunchArgument('preset', default_value='racing',
                              description='racing, report, or the path of a YAML file'),
        DeclareLaunchArgument('run', default_value='runs/launched',
                              description='run folder, which must not hold a run yet'),
        OpaqueFunction(function=nodes),
    ])
