# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One trainer and several cars that come, go, die and stand: nothing is mixed up or lost."""
from collections import Counter
import signal
import sys

from bags.transitions import bag_transitions
from carracing_dqn.bringup.graph import (
    car_graph, learner_graph, NodeSpec, RECORDER, TRAINER,
)
from carracing_dqn.simulation.profiles import find_profile
from dqn_policy_node.action_space import DUMMY_SPACE
from dqn_policy_node.preprocessing import Preprocessor
from graph_probe import Graph, kill, wait_for
from learning_cases import TINY
from msgs_bridge import topics
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.seeds import epsilon_exponent
from msgs_bridge.step import EPISODE_CORE
from msgs_bridge.twists import Command
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool
from stranger import SCALE, Stranger
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.run_folder import RunFolder
from trainer_node.shaping import Shaping
from trainer_node.training import Training
import yaml

MANY = {**TINY, 'replay_capacity': 20_000, 'validation_every_episodes': 0,
        'early_end_frames': 60, 'seed_each_episode': True, 'validation_seed': 2**20}


@pytest.fixture
def cars(tmp_path, request):
    with Graph(tmp_path, f'cars_{request.node.name[5:12]}') as graph:
        graph.listen(topics.DIAGNOSTICS)
        graph.settings = Hyperparameters(**MANY)
        graph.preset = tmp_path / 'many.yaml'
        graph.preset.write_text(yaml.safe_dump(MANY))
        graph.run = tmp_path / 'run'
        yield graph


def name_of(graph, car):
    return f'/{graph.namespace}/car_{car}'


def of_car(graph, car):
    """Return what the trainer says of a car."""
    return graph.health(f'trainer_node: {name_of(graph, car)}')


def learned(graph, car):
    return int(of_car(graph, car).get('decisions', 0))


def add_car(graph, car, listeners, **options):
    settings = graph.settings
    graph.start_graph(car_graph(
        car, simulator=settings.simulator_parameters(car), seed=car, listeners=listeners,
        exponent=epsilon_exponent(car, 3, settings.epsilon_spread), **options),
        graph.namespace, '.')


def pause(graph, car, paused):
    client = graph.probe.create_client(SetBool, f'car_{car}/carracing_sim_node/pause')
    graph.spin_until(client.service_is_ready, 10, 'the service')
    answer = client.call_async(SetBool.Request(data=paused))
    graph.spin_until(answer.done, 10, 'an answer')


def in_replay(training, source):
    """Return what the replay holds of a source, in order, to the byte."""
    replay = training.learning.replay
    arrays = replay.state_arrays()
    slots = np.flatnonzero(arrays['sources'] == training.learning.sources[source].number)
    assert replay.written < replay.capacity
    observations = replay.observations(0, replay.written)
    return [(observations[slot].tobytes(), int(arrays['actions'][slot]),
             float(arrays['rewards'][slot]), bool(arrays['terminated'][slot]),
             observations[after].tobytes())
            for slot, after in zip(slots, slots[1:]) if arrays['acted'][slot]]


def in_bag(training, bag, namespace):
    """Return the transitions of a car in a bag, as learning sees them, and their seeds."""
    description = training.description
    preprocess, shaping = Preprocessor(description.preprocessing), Shaping(training.settings)
    found, seeds, counts = [], set(), Counter()
    for one in bag_transitions([bag], namespace=namespace, counts=counts):
        found.append((
            preprocess(one.frame).tobytes(), int(description.action_space.encode(one.command)),
            float(np.float32(shaping.reward(one))), shaping.terminated(one),
            preprocess(one.next_frame).tobytes()))
        seeds.add(one.step.seed)
    return found, seeds, counts


def test_three_cars_of_which_one_dies_one_stands_and_one_comes_late(cars):
    graph = cars
    trainer, _ = learner_graph(graph.settings, cars=3, trainer={
        'run': str(graph.run), 'preset': str(graph.preset), 'last_validation_seconds': 0.0})
    bag = graph.log_folder / 'bag'
    graph.start_graph(
        (NodeSpec(RECORDER, {'folder': str(bag)}), trainer), graph.namespace, '.')
    for car in (0, 1):
        add_car(graph, car, listeners=2)
    for car in (0, 1):
        graph.spin_until(lambda car=car: learned(graph, car) > 150, 60, f'car {car} learns')
    # one dies as a process does whose host is gone
    for role in ('simulator', 'policy'):
        kill(graph.children[f'{role}_car_0'])
    pause(graph, 1, True)
    graph.spin_until(
        lambda: 'at the moment' in of_car(graph, 1).get('summary', ''), 10, 'one that stands')
    stood = learned(graph, 1)
    assert float(of_car(graph, 1)['silent_seconds']) > 1
    assert f'{name_of(graph, 0)}: no ' in graph.health('trainer_node')['summary']
    # and sends its images compressed
    add_car(graph, 2, listeners=2, compressed=True)
    graph.spin_until(lambda: learned(graph, 2) > 150, 60, 'one that came late')
    assert learned(graph, 1) == stood
    assert of_car(graph, 2)['summary'] == 'learned from'
    pause(graph, 1, False)
    graph.spin_until(lambda: learned(graph, 1) > stood + 100, 30, 'one that goes on')
    epsilons = [float(graph.health(f'car_{car}/dqn_policy_node')['epsilon']) for car in (1, 2)]
    assert epsilons[0] > epsilons[1] > 0
    for name in ('trainer', 'recorder'):
        graph.children[name].asked = True
        graph.children[name].signal(signal.SIGTERM)
        wait_for(lambda name=name: graph.children[name].code is not None, 20, 'the end')
        assert not graph.children[name].failed, graph.children[name].obituary()

    training = Training.resume(graph.run, device='cpu')
    all_seeds = []
    for car in range(3):
        learned_from = in_replay(training, name_of(graph, car))
        recorded, seeds, counts = in_bag(training, bag, name_of(graph, car))
        of = training.learning.sources[name_of(graph, car)]
        assert learned_from == recorded[:len(learned_from)]
        assert of.decisions == len(learned_from) > 150 and not of.left_out
        assert {name for name in counts if counts[name]} <= {'joined', 'duplicate'}
        if car == 0:
            # of the one that died all that was complete is learned from
            assert len(recorded) == len(learned_from)
        all_seeds.append(seeds)
    assert sum(len(in_replay(training, name)) for name in training.learning.sources) == (
        training.decisions)
    assert not set.intersection(*all_seeds) and len(set.union(*all_seeds)) == sum(
        map(len, all_seeds))


def start_trainer(graph, name='trainer', **parameters):
    graph.start_graph((NodeSpec(TRAINER, {
        'run': str(graph.run), 'preset': str(graph.preset), 'sources': 'car_*',
        'last_validation_seconds': 0.0, **SCALE, **parameters}),), graph.namespace, '.')


def test_a_car_that_cannot_be_learned_from_is_named_and_the_rest_goes_on(cars):
    graph = cars
    start_trainer(graph)
    good, bad = Stranger(graph).appear('car_0'), Stranger(graph).appear('car_1')
    command = {'command': DUMMY_SPACE.commands[1]}

    def drive_until(condition, seconds, what, **options):
        good.drive_until(lambda: (bad.frame(**{**command, **options}), condition())[1], seconds,
                         what, **command)

    drive_until(lambda: min(learned(graph, 0), learned(graph, 1)) > 30, 60, 'both')
    # actions that are none of the space
    before = learned(graph, 0)
    drive_until(
        lambda: f'{name_of(graph, 1)}: left out: ' in graph.health('trainer_node')['summary'],
        20, 'a foreign action', command=Command(0.33, 0.0))
    assert int(of_car(graph, 1)['foreign_actions']) > 0
    # another contract
    episodes = graph.publisher(topics.Topic(
        f'car_1/{topics.EPISODE.name}', topics.EPISODE.type_name, '', 10, '', latched=True))
    old = {**dict.fromkeys(EPISODE_CORE, 0.0), 'contract_version': 1.0}
    episodes.publish(fill_named_values(JointState(), old, 1))
    drive_until(lambda: 'version 1 of the contract' in of_car(graph, 1)['summary'], 10, 'it')
    stood = learned(graph, 1)
    drive_until(lambda: learned(graph, 0) > before + 60, 20, 'the other one goes on')
    assert learned(graph, 1) == stood and int(of_car(graph, 1)['lost']) > 0
    episodes.publish(fill_named_values(JointState(), {**old, 'contract_version': 2.0}, 2))
    drive_until(lambda: learned(graph, 1) > stood + 20, 20, 'it is learned from again')
    # a second car of its name, which publishes as this one does
    twin = Stranger(graph)
    twin.step = graph.publisher(topics.Topic(
        f'car_1/{topics.STEP.name}', topics.STEP.type_name, '', 10, ''))
    drive_until(lambda: 'two cars of one name' in of_car(graph, 1)['summary'], 10, 'a twin')
    stood = learned(graph, 1)
    before = learned(graph, 0)
    drive_until(lambda: (twin.frame(), learned(graph, 0) > before + 60)[1], 20, 'the other')
    assert learned(graph, 1) == stood
    graph.probe.destroy_publisher(twin.step)
    drive_until(lambda: learned(graph, 1) > stood + 20, 20, 'alone again')
    # a second trainer
    weights = graph.publisher(topics.WEIGHTS)
    weights.publish(UInt8MultiArray(data=b'x'))
    drive_until(lambda: 'another trainer publishes' in graph.health('trainer_node')['summary'],
                10, 'another trainer')
    assert RunFolder(graph.run).checkpoint.is_file()


def test_what_cannot_be_a_source_is_one_line_and_leaves_nothing(cars):
    start_trainer(cars, sources='/car 1')
    child = cars.children['trainer']
    wait_for(lambda: child.code is not None, 30, 'the end')
    assert child.code == 2 and 'sources has ' in child.obituary() and not cars.run.exists()


def test_a_car_that_joined_says_that_its_trainer_has_gone_and_ends(cars):
    graph = cars
    # each host has a copy of the profile somewhere
    profile = find_profile('carracing')
    (graph.log_folder / 'elsewhere').mkdir(parents=True)
    copies = [folder / 'my_car.yaml'
              for folder in (graph.run.parent, graph.log_folder / 'elsewhere')]
    for copy in copies:
        copy.write_text(f'{profile.read_text()}simulator: carracing\n')
    graph.preset.write_text(yaml.safe_dump({**MANY, 'simulator': str(copies[0])}))
    trainer, _ = learner_graph(graph.settings, cars=1, trainer={
        'run': str(graph.run), 'preset': str(graph.preset), 'last_validation_seconds': 0.0})
    graph.start_graph((trainer,), graph.namespace, '.')
    wait_for(lambda: graph.children['trainer'].said('learning into'), 60, 'the trainer')
    car = graph.start('joined', [
        sys.executable, '-m', 'carracing_dqn.bringup', 'drive', '--join', '--wait', '12',
        '--simulator', str(copies[1]), '--namespace', graph.namespace,
        '--output', str(graph.log_folder / 'car')])
    graph.spin_until(lambda: learned(graph, 0) > 20, 120, 'a car that joined')
    graph.children['trainer'].asked = True
    graph.children['trainer'].signal(signal.SIGTERM)
    wait_for(lambda: car.code is not None, 90, 'the end of the car')
    assert car.code == 0, car.words
    assert car.said('NO TRAINER for') and car.said('has been gone for 12 s: this car ends')
