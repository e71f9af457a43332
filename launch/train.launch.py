# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch trainer, simulator, policy and validator: the car learns."""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from trainer_node.hyperparameters import load_preset


def nodes(context: object) -> list:
    """Return the nodes, set up as the preset says."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    preset = load_preset(value('preset'))
    common = {'package': 'carracing_dqn', 'namespace': value('namespace'), 'output': 'screen'}
    trainer = Node(
        executable='trainer_node', **common,
        parameters=[{'run': value('run'), 'preset': value('preset')}])
    return [
        trainer,
        Node(executable='dqn_policy_node', **common,
             parameters=[{'model': '', 'explore': True, 'seed': preset.seed,
                          'wait_for_subscribers': 2}]),
        Node(executable='validation_node', **common,
             parameters=[{'seed': preset.validation_seed, 'tracks': preset.validation_tracks}]),
        Node(executable='carracing_sim_node', **common, parameters=[{
            **preset.simulator_parameters(),
            'wait_for_subscribers': 1,
        }]),
        RegisterEventHandler(OnProcessExit(
            target_action=trainer, on_exit=[EmitEvent(event=Shutdown(reason='run complete'))])),
    ]


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
