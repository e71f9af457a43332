# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The trainer beside a stranger: it names what is missing, learns in a robot's units, goes on."""

from dqn_policy_node.action_space import DUMMY_SPACE
from geometry_msgs.msg import Twist
from graph_probe import Graph, wait_for
from learning_cases import TINY
from msgs_bridge import topics
from msgs_bridge.twists import Command
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from stranger import SCALE, Stranger
from trainer_node.checkpoint_file import read_checkpoint
from trainer_node.run_folder import RunFolder
import yaml

@pytest.fixture
def graph(tmp_path, request):
    with Graph(tmp_path, 'stranger') as graph:
        graph.listen(topics.DIAGNOSTICS)
        preset = tmp_path / 'tiny.yaml'
        preset.write_text(yaml.safe_dump({
            **TINY, 'validation_every_episodes': 0, **getattr(request, 'param', {})}))
        graph.run = tmp_path / 'run'
        graph.node('trainer_node', 'trainer', run=str(graph.run), preset=str(preset),
                   simulator='nobody', **SCALE)
        yield graph


def says(graph, text):
    return lambda: text in graph.health('trainer_node').get('summary', '')


def learned(graph):
    return int(float(graph.health('trainer_node').get('decisions', 0)))


def test_a_trainer_names_what_is_missing_and_learns_from_any_simulator(graph):
    stranger = Stranger(graph)
    probe = graph.probe
    stranger.drive_until(
        says(graph, 'no step: nobody publishes /stranger/step'), 60, 'no step')
    stranger.step = graph.publisher(topics.STEP)
    stranger.drive_until(says(graph, 'no image_raw: nobody publishes'), 10, 'no image')
    # as cameras publish
    stranger.image = probe.create_publisher(
        Image, 'image_raw', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    stranger.drive_until(says(graph, 'no cmd_vel: nobody publishes'), 10, 'no twist')
    plain = probe.create_publisher(Twist, 'cmd_vel', 10)
    stranger.drive_until(
        says(graph, 'no cmd_vel: nothing that is published on /stranger/cmd_vel fits'), 10,
        'a plain twist')
    probe.destroy_publisher(plain)
    stranger.twist = graph.publisher(topics.CMD_VEL)
    # a twist of a robot that none of the actions means
    stranger.drive_until(says(graph, 'is no action of'), 15, 'a foreign action',
                         command=Command(0.33, 0.0))
    assert learned(graph) == 0
    stranger.drive_until(lambda: learned(graph) > 40, 30, 'learning in m/s and rad/s',
                         command=DUMMY_SPACE.commands[1])
    stranger.drive_until(says(graph, 'learning'), 10, 'all is well',
                         command=DUMMY_SPACE.commands[1])
    _odd_messages(graph, stranger)
    before = learned(graph)
    stranger.drive_until(lambda: learned(graph) > before + 40, 20, 'learning after odd messages',
                         command=DUMMY_SPACE.commands[1])
    stranger.twist = None
    stranger.drive_until(lambda: 'cmd_vel' in graph.health('trainer_node')['summary'], 10,
                         'twists that stopped')
    graph.children['trainer'].process.terminate()
    wait_for(lambda: graph.children['trainer'].process.poll() is not None, 15, 'the end')
    assert graph.children['trainer'].process.returncode == 0
    state = read_checkpoint(RunFolder(graph.run).checkpoint)[1]['learning']
    assert state['decisions'] >= before + 40 and state['updates'] > 0


@pytest.mark.parametrize('graph', [
    {'run_minutes': 2.0, 'epsilon_schedule': 'decisions', 'epsilon_decisions': 10**8}],
    indirect=True)
def test_a_machine_that_is_too_slow_is_told_in_diagnostics_and_once_in_the_log(graph):
    stranger = Stranger(graph)
    stranger.image, stranger.step, stranger.twist = map(
        graph.publisher, (topics.IMAGE, topics.STEP, topics.CMD_VEL))
    stranger.drive_until(says(graph, 'too slow for this recipe: at '), 100, 'the pace',
                         command=DUMMY_SPACE.commands[1])
    assert float(graph.health('trainer_node')['epsilon_at_end']) > 0.9
    stranger.drive_until(lambda: learned(graph) % 7 == 0, 20, 'a little more',
                         command=DUMMY_SPACE.commands[1])
    log = graph.children['trainer'].log.read_text()
    assert log.count('WARN') == log.count('too slow for this recipe') == 1


@pytest.mark.parametrize('graph', [{'samples_per_transition': 1000.0}], indirect=True)
def test_a_trainer_that_is_stopped_saves_and_does_not_learn_what_waits(graph):
    stranger = Stranger(graph)
    stranger.image, stranger.step, stranger.twist = map(
        graph.publisher, (topics.IMAGE, topics.STEP, topics.CMD_VEL))
    stranger.drive_until(lambda: learned(graph) > 20, 60, 'learning',
                         command=DUMMY_SPACE.commands[1])
    # each of them is 125 updates, and nobody is held back
    for _ in range(400):
        stranger.frame(command=DUMMY_SPACE.commands[1])
        graph.spin(0.001)
    trainer = graph.children['trainer'].process
    trainer.terminate()
    wait_for(lambda: trainer.poll() is not None, 15, 'the end')
    assert trainer.returncode == 0
    state = read_checkpoint(RunFolder(graph.run).checkpoint)[1]['learning']
    assert 20 < state['decisions'] < stranger.number - 200


def _odd_messages(graph, stranger):
    """Publish messages whose stamps are far off on every topic, once each."""
    regular = stranger.stamp
    for stamp in (0, 1, 2**31 * 10**9 - 1, regular + 3 * 10**10):
        stranger.stamp = stamp
        stranger.frame(command=DUMMY_SPACE.commands[2])
        stranger.stamp, stranger.number = regular, stranger.number - 1
        graph.spin(0.1)
