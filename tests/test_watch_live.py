# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A graph of real nodes that is watched: seen whole, commanded, and not disturbed."""
import os

from carracing_dqn.watch import live_node
from carracing_dqn.watch.live_node import LiveSource, MAX_SUBSCRIPTIONS
from graph_probe import wait_for
from msgs_bridge import topics
from msgs_bridge.errors import SettingsError
import pytest
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import SetBool


@pytest.fixture
def source():
    source = LiveSource(domain=os.environ['ROS_DOMAIN_ID'])
    yield source
    source.close()


def shown(source, graph):
    return source.state.snapshot(source.now(), f'/{graph.namespace}')


def said(source, text):
    wait_for(lambda: text in source.state.notice, 20, text)


def test_a_graph_that_drives_is_seen_whole_and_obeys(graph, source):
    space = f'/{graph.namespace}'
    graph.node('dqn_policy_node', 'policy', model='racing', wait_for_subscribers=2)
    graph.node('bags.recorder_node', 'recorder', folder=str(graph.log_folder / 'bag'))
    # before it has begun a watch is not one of those for whom it waits
    simulator = graph.node('carracing_sim_node', 'simulator', wait_for_subscribers=2,
                           action_repeat=2)
    wait_for(lambda: simulator.said('lockstep'), 60, 'the simulator')
    wait_for(lambda: 'subscriptions' in source.state.nodes.get(
        f'{space}/carracing_sim_node', None).summary if f'{space}/carracing_sim_node'
        in source.state.nodes else False, 20, 'it says that it waits')
    graph.spin(4.0)
    assert not [topic for topic in shown(source, graph)['topics'] if topic['age'] is not None
                and topic['name'] in (f'{space}/image_raw', f'{space}/step')]
    # the one that was missing
    graph.listen(topics.STEP, topics.IMAGE)
    graph.spin_until(lambda: shown(source, graph)['picture']
                     and shown(source, graph)['drive']['chosen']
                     and shown(source, graph)['switches'].get('enabled') is not None,
                     60, 'the drive')
    graph.spin(3.0)
    now = shown(source, graph)
    assert [cause for cause in now['causes'] if cause['where'].startswith(space)] == []
    assert len(now['drive']['actions']) == 9 and now['drive']['speed'] is not None
    seen = {topic['name']: topic for topic in now['topics']}
    assert seen[f'{space}/step']['rate'] > 5
    assert seen[f'{space}/image_raw']['publishers'][0]['node'] == f'{space}/carracing_sim_node'
    assert source.failed == 0 and now['rejected'] == 0

    source.act('pause', True, space)
    said(source, 'pause: paused')
    wait_for(lambda: shown(source, graph)['switches']['paused'], 10, 'paused')
    # the state of the switch is shown as it comes, the drive as of the last look
    graph.spin(4 * live_node.LOOK_SECONDS)
    before = shown(source, graph)['drive']['decision']
    source.act('step', None, space)
    said(source, 'step: ')
    wait_for(lambda: shown(source, graph)['drive']['decision'] == before + 1, 10, 'one decision')
    source.act('epsilon', 0.25, space)
    said(source, 'epsilon: done')
    wait_for(lambda: shown(source, graph)['switches']['epsilon'] == 0.25, 10, 'epsilon')
    source.act('enable', False, space)
    said(source, 'enable: disabled')
    source.act('reset', None, space)
    said(source, 'reset: ')
    source.act('pause', False, '/nobody')
    said(source, 'nobody here offers it')
    for name, value in (('epsilon', 2.0), ('epsilon', 'x'), ('fly', None), ('pause', 0)):
        with pytest.raises(SettingsError):
            source.act(name, value, space)


def test_nobody_hears_twists_although_they_are_watched(graph, source):
    graph.node('dqn_policy_node', 'policy', model='random')
    graph.node('carracing_sim_node', 'simulator', stepping='real_time', cmd_vel_stamped=False)
    name = f'/{graph.namespace}/dqn_policy_node'
    wait_for(lambda: name in source.state.nodes
             and 'nobody hears' in source.state.nodes[name].summary, 60, 'what it lacks')
    graph.spin(3.0)
    assert 'nobody hears' in source.state.nodes[name].summary


def test_what_others_publish_does_not_end_it(graph, source):
    space = f'/{graph.namespace}'
    bad = [graph.publisher(topic) for topic in (
        topics.IMAGE, topics.STEP, topics.Q_VALUES, topics.CMD_VEL, topics.EPISODE,
        topics.DIAGNOSTICS)]
    other = graph.probe.create_publisher(String, 'words', QoSProfile(
        depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))

    def publish():
        for publisher in bad:
            publisher.publish(b'\x00\x01\x00\x00' + b'\xff' * 64)
            publisher.publish(b'')
        other.publish(String(data='x' * 100_000))
        graph.spin(0.05)

    def heard():
        publish()
        ages = {topic['name']: topic['age'] for topic in shown(source, graph)['topics']}
        return all(ages.get(f'{space}/{name}') is not None
                   for name in ('image_raw', 'step', 'q_values', 'words'))

    wait_for(heard, 60, 'what is wrong')
    wait_for(lambda: shown(source, graph)['rejected'] > 5, 20, 'that it is counted')
    assert source._thread.is_alive()


def test_an_answer_that_is_none_keeps_no_other_from_coming(graph, source):
    def parameters(_, answer):
        answer.values = [ParameterValue(type=99)]
        return answer

    def enable(request, answer):
        answer.message = f'enabled {request.data}'
        return answer

    space = f'/{graph.namespace}'
    graph.probe.create_service(GetParameters, 'odd/get_parameters', parameters)
    graph.probe.create_service(SetBool, 'odd/enable', enable)
    graph.spin_until(lambda: source.failed, 20, 'an answer that is none')
    failed = source.failed
    source.act('enable', True, space)
    graph.spin_until(lambda: source.state.notice == 'enable: enabled True', 20, 'the next answer')
    graph.spin(1.0)
    assert source.failed <= failed + 1 and not source._pending


def test_a_car_is_heard_among_many_topics_of_others(graph, source):
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    for number in range(MAX_SUBSCRIPTIONS + 5):
        graph.probe.create_publisher(String, f'a_{number:03d}', qos)
    graph.spin_until(lambda: len(source._ears) == MAX_SUBSCRIPTIONS, 30, 'the others')
    # what comes later is no less the car's
    step = graph.publisher(topics.STEP)

    def heard():
        step.publish(b'\x00\x01\x00\x00')
        graph.spin(0.05)
        return any(topic['name'] == f'/{graph.namespace}/step' and topic['age'] is not None
                   for topic in shown(source, graph)['topics'])

    wait_for(heard, 30, 'the car')
    assert len(source._ears) == MAX_SUBSCRIPTIONS


def test_a_topic_that_cannot_be_heard_leaves_the_others_and_is_tried_again(
        graph, source, monkeypatch):
    name, other = f'/{graph.namespace}/words', f'/{graph.namespace}/other'

    def heard(publisher, topic):
        publisher.publish(String(data='x'))
        graph.spin(0.05)
        seen = {one['name']: one['age'] for one in shown(source, graph)['topics']}
        return seen.get(topic) is not None and seen[topic] < 1.0

    listen = source._listen

    def fail(name, *rest):
        if name.endswith('words'):
            raise RuntimeError('too many open files')
        return listen(name, *rest)

    monkeypatch.setattr(source, '_listen', fail)
    words = graph.probe.create_publisher(String, 'words', 10)
    others = graph.probe.create_publisher(String, 'other', 10)
    wait_for(lambda: heard(others, other), 30, 'another topic')
    graph.spin_until(lambda: source._refused, 30, 'that it is refused')
    assert name not in source._ears
    monkeypatch.setattr(live_node, 'REFUSED_SECONDS', 0.0)
    monkeypatch.setattr(source, '_listen', listen)
    source._refused.clear()
    wait_for(lambda: heard(words, name), 30, 'a word again')
