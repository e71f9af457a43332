# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the command hears of a graph: everything of its own, nothing that ends it."""
import time

from carracing_dqn.bringup.graph import KINDS, SIMULATOR
from carracing_dqn.bringup.monitor import absolute_namespace, KEPT_RESULTS, Monitor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.health import SUMMARY_LENGTH
from msgs_bridge.listening_node import node_of_a_command
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.step import EPISODE_CORE, VALIDATION_FIELDS
import pytest
from sensor_msgs.msg import JointState

ENDED = {**dict.fromkeys(EPISODE_CORE, 0.0), 'truncated': 1.0, 'episode_return': 7.0}


def bundle(values, stamp=1):
    return fill_named_values(JointState(), values, stamp)


def health(*nodes, text='driving', values=()):
    return DiagnosticArray(status=[
        DiagnosticStatus(name=node, message=text, values=list(values)) for node in nodes])


@pytest.fixture
def monitor(graph):
    monitor = Monitor(graph.namespace)
    yield monitor
    monitor.close()


def wait(graph, condition, what):
    graph.spin_until(condition, 60, what)


def test_no_message_ends_it_and_only_episodes_that_have_ended_count(graph, monitor):
    episodes, validations, diagnostics = map(
        graph.publisher, (topics.EPISODE, topics.VALIDATION, topics.DIAGNOSTICS))
    wait(graph, lambda: all(publisher.get_subscription_count() for publisher in (
        episodes, validations, diagnostics)), 'the monitor')
    for bad in (JointState(name=['hello'], position=[1.0]), JointState(position=[1.0, 2.0]),
                bundle({**ENDED, 'episode_return': float('nan')})):
        episodes.publish(bad)
        validations.publish(bad)
    diagnostics.publish(health('', '/', '///', f'/{graph.namespace}/', 'x' * 100_000))
    episodes.publish(bundle({**ENDED, 'truncated': 0.0}))
    episodes.publish(bundle(ENDED))
    validations.publish(bundle(dict.fromkeys(VALIDATION_FIELDS, 1.0)))
    state = monitor.state
    wait(graph, lambda: state.ended and state.validations, 'the good ones')
    assert (state.ended, state.mean_return, len(state.validations)) == (1, 7.0, 1)
    assert state.rejected == 6
    assert state.health == {}


def test_a_message_that_is_none_does_not_end_it(graph, monitor):
    # bytes that the middleware cannot read, sent as an honest publisher would
    episodes = graph.publisher(topics.EPISODE)
    wait(graph, episodes.get_subscription_count, 'the monitor')
    for data in (b'\x00\x01\x00\x00' + b'\xff' * 64, b'\x00\x01\x00\x00' + b'\x7f' * 999):
        episodes.publish(data)
    episodes.publish(bundle(ENDED))
    wait(graph, lambda: monitor.state.ended == 1, 'the good one')


def test_each_namespace_has_its_own_health_and_texts_are_bounded(graph, monitor):
    diagnostics = graph.publisher(topics.DIAGNOSTICS)
    wait(graph, diagnostics.get_subscription_count, 'the monitor')
    name = SIMULATOR.name
    own = f'/{graph.namespace}/{name}'
    long = [KeyValue(key='decisions_per_second', value='7'),
            *(KeyValue(key=f'{number}\x1b[31m' * 1000, value='9' * 10_000)
              for number in range(1000))]
    diagnostics.publish(health(f'/other/{name}', f'/{name}', f'{own}/{name}', text='not ours'))
    diagnostics.publish(health(own, text='[/x]\x1b]52;c;aGk=\x07' + 'y' * 10_000, values=long))
    diagnostics.publish(health(f'/other/{name}', f'/{graph.namespace}/nobody', text='not ours'))
    state = monitor.state
    wait(graph, lambda: state.health, 'our health')
    time.sleep(0.5)
    assert list(state.health) == [own]
    assert state.value(name, 'decisions_per_second') == 7
    assert '[/x]' in state.summary(name) and '\x1b' not in state.summary(name)
    texts = [*state.health[own], *state.health[own].values()]
    assert len(texts) < 300 and max(map(len, texts)) <= SUMMARY_LENGTH
    assert all(text.isprintable() for text in texts)


def test_what_is_kept_is_bounded_and_all_are_counted(graph, monitor):
    for number in range(3 * KEPT_RESULTS):
        monitor.state.take_episode(bundle({**ENDED, 'episode_return': float(number)}))
    assert monitor.state.ended == 3 * KEPT_RESULTS
    assert len(monitor.state.episodes) == KEPT_RESULTS
    assert monitor.state.mean_return == (3 * KEPT_RESULTS - 1) / 2
    for large in ({f'x{number}': 1.0 for number in range(1000)}, {'x' * 10_000: 1.0}):
        with pytest.raises(MessageError, match='accepted: up to'):
            monitor.state.take_episode(bundle({**ENDED, **large}))


def test_it_hears_again_after_a_flood(graph, monitor):
    flood, episodes = graph.publisher(topics.DIAGNOSTICS), graph.publisher(topics.EPISODE)
    wait(graph, lambda: flood.get_subscription_count() and episodes.get_subscription_count(), 'it')
    message = health('/x', text='z' * 5000)
    until = time.monotonic() + 2
    while time.monotonic() < until:
        flood.publish(message)
    flood.publish(health(f'/{graph.namespace}/{SIMULATOR.name}', text='after'))
    episodes.publish(bundle(ENDED))
    wait(graph, lambda: monitor.state.ended == 1
         and monitor.state.summary(SIMULATOR.name) == 'after', 'what came after the flood')


@pytest.mark.parametrize(('text', 'namespace'), [
    ('', ''), ('/', ''), ('car', '/car'), ('/a/b/', '/a/b')])
def test_namespaces_are_made_absolute(text, namespace):
    assert absolute_namespace(text) == namespace


@pytest.mark.parametrize('text', [
    'a b', '1car', 'a//b', 'x' * 240, 'x' * 1000, '[/x]', 'a\x1b[31m'])
def test_what_is_no_namespace_is_named(text):
    with pytest.raises(BridgeError, match='--namespace is') as found:
        absolute_namespace(text)
    assert len(str(found.value)) < 400 and str(found.value).isprintable()


@pytest.mark.parametrize(('domain', 'namespace', 'told'), [
    ('foo', '', "ROS_DOMAIN_ID is 'foo'"), ('233', '', "ROS_DOMAIN_ID is '233'"),
    ('1', '/' + 'x' * 240, 'ROS does not start')])
def test_what_keeps_a_node_of_a_command_from_starting_is_one_line(
        monkeypatch, domain, namespace, told):
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    with pytest.raises(BridgeError, match=told) as caught:
        node_of_a_command('some_command', namespace)
    assert '\n' not in str(caught.value)


def test_names_and_roles_of_nodes_are_unique():
    assert len({kind.name for kind in KINDS}) == len({kind.role for kind in KINDS}) == len(KINDS)
