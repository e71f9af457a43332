# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The graph as data: its nodes, their parameters, and who waits for whom.

The `carracing` command and the launch files start what the functions here return; neither has a
node parameter of its own. Nothing here imports ROS.
"""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

from msgs_bridge.settings import describe
from trainer_node.settings import TrainerSettings


@dataclasses.dataclass(frozen=True)
class NodeKind:
    """
    A program that may stand in a graph.

    Attributes:
        name: name of the node and of its executable.
        role: what it is in a graph, in one word; names its process and its log.
        module: what `python -m` runs.
        settings: the class of its parameters, or what returns it, as module:name.
        hears_all: whether it subscribes to `image_raw`, `step` and `cmd_vel` and must miss
            nothing on them, so that simulator and policy wait for it.
        keeps: whether it has something to save when it is stopped.
        nice: how much of its share of the processor it leaves to the others.
    """

    name: str
    role: str
    module: str
    settings: str
    hears_all: bool = False
    keeps: bool = False
    nice: int = 0


SIMULATOR = NodeKind(
    'carracing_sim_node', 'simulator', 'carracing_sim_node',
    'carracing_dqn.simulation.settings:node_settings')
POLICY = NodeKind(
    'dqn_policy_node', 'policy', 'dqn_policy_node', 'dqn_policy_node.settings:PolicySettings')
TRAINER = NodeKind(
    'trainer_node', 'trainer', 'trainer_node', 'trainer_node.settings:TrainerSettings',
    hears_all=True, keeps=True)
# validation takes the time that the others leave
VALIDATOR = NodeKind(
    'validation_node', 'validator', 'carracing_dqn.evaluation.node',
    'carracing_dqn.evaluation.settings:ValidationSettings', nice=5)
RECORDER = NodeKind(
    'bag_recorder_node', 'recorder', 'bags.recorder_node', 'bags.settings:RecorderSettings',
    hears_all=True, keeps=True)
PLAYER = NodeKind(
    'bag_player_node', 'player', 'bags.player_node', 'bags.settings:PlayerSettings')
REFEREE = NodeKind(
    'referee_node', 'referee', 'carracing_dqn.simulation.referee_node',
    'carracing_dqn.simulation.referee_settings:RefereeSettings')

KINDS = (SIMULATOR, POLICY, TRAINER, VALIDATOR, RECORDER, PLAYER, REFEREE)
"""Every node of the package."""


@dataclasses.dataclass(frozen=True)
class NodeSpec:
    """
    One node of a graph.

    Attributes:
        kind: which program.
        parameters: values by name, str, int, float or bool; the others keep their defaults.
    """

    kind: NodeKind
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)


Graph = tuple[NodeSpec, ...]
"""Nodes in the order in which they start: who must miss nothing comes before who speaks."""


def driving_graph(
    *, model: str, seed: int, simulator: str = 'carracing', episodes: int = 0,
    stepping: str = 'lockstep', action_repeat: int = 1,
    policy: Mapping[str, Any] | None = None, bag: str | None = None,
) -> Graph:
    """
    Return simulator and policy, and a recorder if there is to be a bag.

    Args:
        model: model folder, name of a shipped model, or 'random'.
        seed: seed of the first episode; the next ones count up.
        simulator: name of an installed one, or module:Class.
        episodes: episodes to drive; 0 = no end.
        stepping: 'lockstep' or 'real_time'.
        action_repeat: simulated frames for each one that is published.
        policy: further parameters of the policy.
        bag: new folder for a bag of every topic.
    """
    return _connected(
        *_recorder(bag),
        NodeSpec(POLICY, {'model': model, **(policy or {})}),
        NodeSpec(SIMULATOR, {
            'simulator': simulator, 'seed': seed, 'seed_each_episode': True,
            'episodes': episodes, 'stepping': stepping, 'action_repeat': action_repeat}))


def training_graph(
    hyperparameters: Any, *, trainer: Mapping[str, Any], first_episode: int = 0,
    first_decision: int = 0, vehicle: Mapping[str, Any] | None = None, bag: str | None = None,
) -> Graph:
    """
    Return trainer, policy, validator and simulator, and a recorder if there is to be a bag.

    Args:
        hyperparameters: `trainer_node.hyperparameters.Hyperparameters` of the run.
        trainer: parameters of the trainer.
        first_episode: number of the first episode, when the run goes on.
        first_decision: decisions of the run so far, when it goes on.
        vehicle: parameters of the policy and, where it has them, of the trainer: the camera and
            the units of the commands.
        bag: new folder for a bag of every topic.
    """
    return _connected(
        *_recorder(bag),
        NodeSpec(TRAINER, {**{name: value for name, value in (vehicle or {}).items()
                              if name in describe(TrainerSettings)}, **trainer}),
        # without a model it waits for the first weights; other random actions after a resume
        NodeSpec(POLICY, {**(vehicle or {}), 'model': '', 'explore': True,
                          'seed': (hyperparameters.seed + first_decision) % 2**31}),
        NodeSpec(VALIDATOR, {'simulator': hyperparameters.simulator,
                             'seed': hyperparameters.validation_seed,
                             'tracks': hyperparameters.validation_tracks}),
        NodeSpec(SIMULATOR, {
            **hyperparameters.simulator_parameters(), 'first_episode': first_episode}))


def replay_graph(*, bag: str, rate: float = 1.0) -> Graph:
    """Return a player that publishes a bag, at `rate` times the recorded pace."""
    return (NodeSpec(PLAYER, {'bag': bag, 'rate': rate}),)


def _recorder(bag: str | None) -> Graph:
    return () if bag is None else (NodeSpec(RECORDER, {'folder': bag}),)


def _connected(*nodes: NodeSpec) -> Graph:
    """Let simulator and policy wait for everybody who must miss nothing of what they send."""
    listeners = sum(node.kind.hears_all for node in nodes)
    # the simulator hears the policy's twists, too; it counts the policy itself
    waits = {SIMULATOR: listeners, POLICY: listeners + 1}
    return tuple(
        dataclasses.replace(node, parameters={
            **node.parameters, 'wait_for_subscribers': waits[node.kind]})
        if node.kind in waits else node for node in nodes)
