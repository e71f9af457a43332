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

from msgs_bridge import topics
from msgs_bridge.seeds import epsilon_exponent
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

ANNOTATOR = NodeKind(
    'image_annotator_node', 'annotator', 'carracing_dqn.watch.annotator_node',
    'carracing_dqn.watch.annotator_settings:AnnotatorSettings', nice=5)
TELEOP = NodeKind(
    'teleop_node', 'teleop', 'carracing_dqn.teleop.teleop_node',
    'carracing_dqn.teleop.settings:TeleopSettings')
RACE = NodeKind(
    'race_node', 'race', 'carracing_dqn.teleop.race_node',
    'carracing_dqn.teleop.settings:RaceSettings')

CAR = 'car_'
"""Begins the namespaces of cars, which go on with their number."""

RACE_PATIENCE = 3600.0
"""How long the simulator of a race waits for a person before it sends a frame again; seconds."""

# a prime, so that cars do not meet the seeds of neighbouring runs soon
SEEDS_APART = 1_000_003

KINDS = (SIMULATOR, POLICY, TRAINER, VALIDATOR, RECORDER, PLAYER, REFEREE, ANNOTATOR, TELEOP,
         RACE)
"""Every node of the package."""


@dataclasses.dataclass(frozen=True)
class NodeSpec:
    """
    One node of a graph.

    Attributes:
        kind: which program.
        parameters: values by name, str, int, float or bool; the others keep their defaults.
        space: namespace below that of the graph; a node there may die, and the graph goes on.
        shared: topics that are those of the graph's namespace nevertheless.
    """

    kind: NodeKind
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    space: str = ''
    shared: tuple[str, ...] = ()

    @property
    def role(self) -> str:
        """Return what it is in its graph, in a word that no other node there has."""
        return f'{self.kind.role}_{self.space}' if self.space else self.kind.role

    def namespace(self, graph: str) -> str:
        """Return its namespace, '' for the root, in a graph with a namespace or ''."""
        return '/'.join(filter(None, (graph.strip('/'), self.space)))

    def remaps(self, graph: str) -> dict[str, str]:
        """Return what its topics are called instead, in a graph with a namespace or ''."""
        return {topic: '/'.join(['', *filter(None, (graph.strip('/'), topic))])
                for topic in self.shared}


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


def race_graph(
    *, seed: int, episodes: int, race: Mapping[str, Any], bag: str | None = None,
) -> Graph:
    """
    Return simulator and the window of a person, and a recorder if there is to be a bag.

    Args:
        seed: as for `driving_graph`.
        episodes: as for `driving_graph`.
        race: parameters of the window.
        bag: new folder for a bag of every topic.
    """
    return _connected(
        *_recorder(bag), NodeSpec(RACE, {'laps': episodes, **race}),
        NodeSpec(SIMULATOR, {'seed': seed, 'seed_each_episode': True, 'episodes': episodes,
                             # for a frame that waits for its lap to begin
                             'answer_timeout': RACE_PATIENCE}))


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
        NodeSpec(TRAINER, {**_of_trainer(vehicle), **trainer}),
        # without a model it waits for the first weights
        NodeSpec(POLICY, {**(vehicle or {}), 'model': '', 'explore': True,
                          'seed': driver_seed(hyperparameters.seed, first_decision)}),
        _validator(hyperparameters),
        NodeSpec(SIMULATOR, {
            **hyperparameters.simulator_parameters(), 'first_episode': first_episode}))


def car_space(car: int) -> str:
    """Return the namespace of a car below that of its trainer."""
    return f'{CAR}{car}'


def learner_graph(
    hyperparameters: Any, *, trainer: Mapping[str, Any], cars: int = 0,
    vehicle: Mapping[str, Any] | None = None,
) -> Graph:
    """
    Return trainer and validator for cars that are elsewhere.

    Args:
        hyperparameters: as for `training_graph`.
        trainer: parameters of the trainer.
        cars: how many are counted on; others may come.
        vehicle: as for `training_graph`.
    """
    return (
        NodeSpec(TRAINER, {
            **_of_trainer(vehicle), 'sources': f'{CAR}*', 'cars': cars, **trainer}),
        _validator(hyperparameters))


def car_graph(
    car: int, *, simulator: Mapping[str, Any], seed: int, exponent: float,
    vehicle: Mapping[str, Any] | None = None, listeners: int = 1, compressed: bool = False,
) -> Graph:
    """
    Return simulator and policy of one of several cars, in a namespace of their own.

    Args:
        car: its number.
        simulator: parameters of the simulator.
        seed: of its random actions.
        exponent: what epsilon is raised to.
        vehicle: as for `training_graph`.
        listeners: nodes elsewhere that must miss nothing, the trainer among them.
        compressed: whether its images are compressed, without loss.
    """
    camera, image = (({'camera_compressed': True}, {'image_compressed': True}) if compressed
                     else ({}, {}))
    return _connected(
        NodeSpec(POLICY, {**(vehicle or {}), **camera, 'model': '', 'explore': True,
                          'seed': seed % 2**31, 'epsilon_exponent': exponent},
                 car_space(car), (topics.WEIGHTS.name,)),
        # each has a time of its own
        NodeSpec(SIMULATOR, {**simulator, **image, 'publish_clock': False}, car_space(car)),
        listeners=listeners)


def cars_graph(
    hyperparameters: Any, cars: int, *, trainer: Mapping[str, Any],
    episodes: Mapping[str, int] | None = None, first_decision: int = 0,
    vehicle: Mapping[str, Any] | None = None, bag: str | None = None, namespace: str = '',
) -> Graph:
    """
    Return a trainer, a validator and several cars, and a recorder if there is to be a bag.

    Args:
        hyperparameters: as for `training_graph`.
        cars: how many.
        trainer: parameters of the trainer.
        episodes: how many each source has behind it, by its name, when the run goes on.
        first_decision: as for `training_graph`.
        vehicle: as for `training_graph`.
        bag: new folder for a bag of every topic.
        namespace: of the graph, which is part of the names of the sources.
    """
    recorder = _recorder(bag)
    graph = [*recorder, *learner_graph(
        hyperparameters, trainer=trainer, cars=cars, vehicle=vehicle)]
    for car in range(cars):
        name = '/'.join(['', *filter(None, (namespace.strip('/'), car_space(car)))])
        graph += one_of_the_cars(
            hyperparameters, car, cars, first_episode=(episodes or {}).get(name, 0),
            first_decision=first_decision, vehicle=vehicle, listeners=1 + len(recorder))
    return tuple(graph)


def one_of_the_cars(
    hyperparameters: Any, car: int, cars: int, *, first_episode: int = 0,
    first_decision: int = 0, vehicle: Mapping[str, Any] | None = None, listeners: int = 1,
) -> Graph:
    """
    Return one car of a run whose settings are known here.

    Args:
        hyperparameters: as for `training_graph`.
        car: its number.
        cars: how many there are.
        first_episode: episodes that it has behind it.
        first_decision: as for `training_graph`.
        vehicle: as for `training_graph`.
        listeners: as for `car_graph`.
    """
    return car_graph(
        car, vehicle=vehicle, listeners=listeners,
        simulator={**hyperparameters.simulator_parameters(car), 'first_episode': first_episode},
        seed=driver_seed(hyperparameters.seed, first_decision, car),
        exponent=epsilon_exponent(car, cars, hyperparameters.epsilon_spread))


def driver_seed(seed: int, first_decision: int, car: int = 0) -> int:
    """Return the seed of random actions: others for each car, and after a run was resumed."""
    return (seed + first_decision + car * SEEDS_APART) % 2**31


def replay_graph(*, bag: str, rate: float = 1.0) -> Graph:
    """Return a player that publishes a bag, at `rate` times the recorded pace."""
    return (NodeSpec(PLAYER, {'bag': bag, 'rate': rate}),)


def _of_trainer(vehicle: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return what of the parameters of a vehicle the trainer has, too."""
    return {name: value for name, value in (vehicle or {}).items()
            if name in describe(TrainerSettings)}


def _validator(hyperparameters: Any) -> NodeSpec:
    return NodeSpec(VALIDATOR, {'simulator': hyperparameters.simulator,
                                'seed': hyperparameters.validation_seed,
                                'tracks': hyperparameters.validation_tracks})


def _recorder(bag: str | None) -> Graph:
    return () if bag is None else (NodeSpec(RECORDER, {'folder': bag}),)


def _connected(*nodes: NodeSpec, listeners: int = 0) -> Graph:
    """Let simulator and policy wait for everybody who must miss nothing of what they send."""
    listeners += sum(node.kind.hears_all for node in nodes)
    # the simulator hears the driver's twists, too; it counts the driver itself
    waits = {SIMULATOR: listeners, POLICY: listeners + 1, RACE: listeners + 1}
    return tuple(
        dataclasses.replace(node, parameters={
            **node.parameters, 'wait_for_subscribers': waits[node.kind]})
        if node.kind in waits else node for node in nodes)
