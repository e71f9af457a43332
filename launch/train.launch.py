# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Launch trainer, simulator, policy and validator: the car learns."""
from carracing_dqn.bringup.graph import training_graph
from carracing_dqn.bringup.launch_graph import launch_actions
from carracing_dqn.bringup.recipe import pairs_of_simulator
from carracing_dqn.simulation.profiles import profile_of
from carracing_dqn.studies.simulator_settings import choose_preset
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from trainer_node.hyperparameters import load_preset
from trainer_node.open_run import read_overrides


def nodes(context: object) -> list:
    """Return what starts the nodes, set up as the preset says."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    simulator, run = value('simulator') or None, value('run')
    preset = choose_preset(value('preset') or None, simulator)
    # the nodes stay in the folder that launch was called in
    pairs = [*pairs_of_simulator(simulator, preset, '.'),
             *filter(None, value('overrides').split(','))]
    settings = load_preset(preset, read_overrides(pairs))
    return launch_actions(training_graph(
        settings, vehicle=profile_of(settings.simulator).vehicle,
        trainer={'run': run, 'preset': preset, 'overrides': ','.join(pairs)}),
        value('namespace'))


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and their arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
        DeclareLaunchArgument('simulator', default_value='',
                              description='what to learn in: a name or a profile; empty: '
                              "the preset's"),
        DeclareLaunchArgument('preset', default_value='',
                              description='racing, report, or the path of a YAML file; empty: '
                              "the simulator's, or racing"),
        DeclareLaunchArgument('overrides', default_value='',
                              description='other hyperparameters: name=value,name=value'),
        DeclareLaunchArgument('run', default_value='runs/launched',
                              description='run folder, which must not hold a run yet'),
        OpaqueFunction(function=nodes),
    ])
