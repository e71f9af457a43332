# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder and player as real processes over real DDS."""
from collections import Counter, defaultdict
import json
from pathlib import Path
import re
import resource
import shutil
import signal
import subprocess
import sys
import time

from bag_cases import read_all, record_drive, serialized, small_bag
from bags.errors import BagError
from bags.live_qos import Kind
from bags.qos_text import offered_qos
from bags.reader import BagReader
from bags.recorded_topic import RecordedTopic
from bags.recover import recover_bag
from bags.schemas import Schema
from bags.transitions import bag_transitions
from bags.verify import verify_bag
from bags.writer import BagWriter
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from forger import TYPES
from geometry_msgs.msg import Twist
from graph_probe import carracing, kill, ROOT, wait_for
from mcap.reader import make_reader
from msgs_bridge import topics
from msgs_bridge.images import fill_image
import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy, LivelinessPolicy, qos_profile_sensor_data, QoSProfile, ReliabilityPolicy,
)
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float32, String
from std_srvs.srv import SetBool, Trigger

RECORDER = ('bags.recorder_node', 'bag_recorder_node')
PLAYER = ('bags.player_node', 'bag_player_node')
SIM = ('carracing_sim_node', 'carracing_sim_node')
POLICY = ('dqn_policy_node', 'dqn_policy_node')


def start_recorder(graph, folder, **parameters):
    child = graph.node(*RECORDER, folder=str(folder), **parameters)
    wait_for(lambda: any('recording' in line for line in child.words), 60, 'recording')
    return child


def stop(child, number=signal.SIGTERM):
    child.process.send_signal(number)
    # a busy machine takes longer than the two seconds that a bag is closed within
    code = child.process.wait(20)
    return code


def drive(graph, **options):
    graph.listen(topics.EPISODE, topics.STEP, topics.IMAGE)
    policy = graph.node(*POLICY, model='random')
    wait_for(lambda: any('driving with' in line for line in policy.words), 20, 'policy')
    # DDS tells nobody when the policy has found the recorder; on a busy machine it takes a second
    time.sleep(2)
    graph.node(*SIM, seed=11, seed_each_episode=True, wait_for_subscribers=2, **options)


def test_everything_a_drive_publishes_is_in_the_bag_to_the_byte(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag', provenance='{"simulator": '
                              '{"max_episode_frames": 60, "seed": 11}, "model": "random"}')
    drive(graph, max_episode_frames=60, episodes=3)
    graph.spin_until(lambda: len(graph.messages['step']) == 3 * 61, 40, 'three episodes')
    simulator = graph.children[SIM[1]]
    wait_for(lambda: any('3 episodes driven' in line for line in simulator.words), 10, 'the end')
    assert stop(recorder) == 0
    assert any('lost: none' in line for line in recorder.words), recorder.words
    space = f'/{graph.namespace}'
    with BagReader(tmp_path / 'bag') as reader:
        found = verify_bag(reader)
        assert found.good, found.problems
        assert found.resimulation.frames == 3 * 61
        assert found.transitions == {'joined': 180}
        assert reader.custom_data['model'] == 'random'
        for name in ('image_raw', 'step'):
            assert reader.topics[f'{space}/{name}'].message_count == 3 * 61
        qos, = reader.topics[f'{space}/episode'].qos
        assert (qos['durability'], qos['reliability']) == ('transient_local', 'reliable')
        assert '/rosout' in reader.topics
        stamped = read_all(reader)
    times = [one[1] for one in stamped]
    assert times == sorted(times)
    assert all(publish <= log for _, log, publish, _ in stamped)
    recorded = [deserialize_message(data, JointState) for name, _, _, data in stamped
                if name == f'{space}/step']
    assert recorded == graph.messages['step']
    with Reader(tmp_path / 'bag') as reader:
        assert sum(1 for _ in reader.messages()) == len(stamped)
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as file:
        found = make_reader(file, validate_crcs=True).iter_messages()
        assert [(channel.topic, message.log_time, message.publish_time, message.data)
                for _, channel, message in found] == stamped


def test_a_killed_recorder_leaves_all_but_the_last_second(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag', chunk_seconds=0.2)
    drive(graph, max_episode_frames=200)
    graph.spin_until(lambda: graph.messages['step'], 30, 'the first step')
    began = time.monotonic()
    graph.spin_until(lambda: len(graph.messages['step']) > 300, 30, 'steps')
    rate = len(graph.messages['step']) / (time.monotonic() - began)
    kill(recorder)
    graph.spin(0.0)
    before = len(graph.messages['step'])
    with pytest.raises(BagError, match='carracing bag recover'):
        BagReader(tmp_path / 'bag')
    recovery = recover_bag(tmp_path / 'bag', tmp_path / 'out')
    with BagReader(tmp_path / 'out') as reader:
        kept = reader.topics[f'/{graph.namespace}/step'].message_count
        found = verify_bag(reader)
    assert found.good, found.problems
    assert recovery.messages > 4 * kept
    # a chunk every 0.2 s, on a machine that may be busy: well within the second that is allowed
    assert before - kept <= rate
    assert found.transitions['joined'] >= kept - 3, (found.transitions, found.notes)


def test_a_played_bag_records_into_the_same_transitions(graph, tmp_path):
    bag = record_drive(tmp_path / 'source', decisions=50, namespace=f'/{graph.namespace}')
    expected = list(bag_transitions([bag]))
    recorder = start_recorder(graph, tmp_path / 'again')
    player = graph.node(*PLAYER, bag=str(bag), rate=3.0, wait_for_subscribers=10.0)
    assert player.process.wait(30) == 0
    wait_for(lambda: any('messages played' in line for line in player.words), 5, 'the end')
    assert any('timing error p50' in line for line in player.words)
    assert stop(recorder, signal.SIGINT) == 0
    counts = Counter()
    found = list(bag_transitions([tmp_path / 'again'], counts=counts))
    assert {name: count for name, count in counts.items() if count} == {'joined': 100}
    for one, other in zip(found, expected, strict=True):
        assert (one.stamp, one.next_stamp, one.command, one.step, one.previous) == (
            other.stamp, other.next_stamp, other.command, other.step, other.previous)
        assert np.array_equal(one.frame, other.frame)
        assert np.array_equal(one.next_frame, other.next_frame)
    with BagReader(bag) as source, BagReader(tmp_path / 'again') as again:
        name = f'/{graph.namespace}/q_values'
        assert [bytes(one.data) for one in source.messages([name])] == [
            bytes(one.data) for one in again.messages([name])]
        assert again.topics[f'/{graph.namespace}/episode'].qos[0][
            'durability'] == 'transient_local'


def test_nothing_is_lost_at_600_decisions_a_second(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    published = (topics.IMAGE, topics.STEP, topics.REWARD, topics.CMD_VEL, topics.Q_VALUES)
    publishers = [graph.publisher(topic) for topic in published]
    wait_for(lambda: all(one.get_subscription_count() for one in publishers), 10, 'recorder')
    image = fill_image(Image(), np.zeros((96, 96, 3), np.uint8), 1, 'car')
    bundle = JointState(name=[f'value {number}' for number in range(26)], position=[0.0] * 26)
    messages = [image, bundle, Float32(), graph_twist(), bundle]
    began = time.monotonic()
    for number in range(900):
        for publisher, message in zip(publishers, messages):
            publisher.publish(message)
        time.sleep(max(0.0, began + number / 600 - time.monotonic()))
    time.sleep(0.3)
    assert stop(recorder) == 0
    assert any('lost: none' in line for line in recorder.words), recorder.words
    with BagReader(tmp_path / 'bag') as reader:
        for topic in published:
            assert reader.topics[f'/{graph.namespace}/{topic.name}'].message_count == 900


def graph_twist():
    from geometry_msgs.msg import TwistStamped
    return TwistStamped()


def test_topics_of_any_type_and_qos_are_recorded_as_they_appear(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    space = f'/{graph.namespace}'
    # another camera, best effort; plain twists; a topic nobody knew; one latched before
    camera = graph.probe.create_publisher(Image, 'image_raw', qos_profile_sensor_data)
    twists = graph.probe.create_publisher(Twist, 'cmd_vel', 10)
    words = graph.probe.create_publisher(String, 'words', 10)
    latched = graph.probe.create_publisher(
        String, 'latched', QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    hidden = graph.probe.create_publisher(String, '_hidden', 10)
    latched.publish(String(data='still here'))
    publishers = (camera, twists, words, latched)
    wait_for(lambda: all(one.get_subscription_count() for one in publishers), 10, 'recorder')
    camera.publish(Image())
    twists.publish(Twist())
    words.publish(String(data='hello'))
    hidden.publish(String(data='not for bags'))
    time.sleep(0.4)
    assert stop(recorder) == 0
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.problems == []
        counts = {name: topic.message_count for name, topic in reader.topics.items()
                  if name.startswith(space)}
        assert counts == {f'{space}/{name}': 1
                          for name in ('image_raw', 'cmd_vel', 'words', 'latched')}
        assert reader.topics[f'{space}/image_raw'].qos[0]['reliability'] == 'best_effort'
        assert reader.topics[f'{space}/cmd_vel'].type_name == 'geometry_msgs/msg/Twist'
        message, = reader.messages([f'{space}/words'])
        assert deserialize_message(bytes(message.data), String).data == 'hello'


def test_only_the_topics_asked_for_are_recorded(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag', topics='words, step, never')
    words = graph.probe.create_publisher(String, 'words', 10)
    other = graph.probe.create_publisher(String, 'other', 10)
    steps = graph.publisher(topics.STEP)
    wait_for(lambda: words.get_subscription_count() and steps.get_subscription_count(), 10,
             'recorder')
    for publisher, message in ((words, String()), (other, String()), (steps, JointState())):
        publisher.publish(message)
    time.sleep(0.3)
    assert stop(recorder) == 0
    space = f'/{graph.namespace}'
    assert any(f'never seen: {space}/never' in line for line in recorder.words)
    with BagReader(tmp_path / 'bag') as reader:
        assert set(reader.topics) == {f'{space}/words', f'{space}/step'}


def sqlite_bag(folder, space):
    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(
            f'{space}/words', 'std_msgs/msg/String', typestore=types)
        for number in range(20):
            text = types.types['std_msgs/msg/String'](f'word {number}')
            writer.write(connection, 10 ** 9 + number * 10 ** 7,
                         types.serialize_cdr(text, 'std_msgs/msg/String'))


def test_a_sqlite3_bag_written_by_rosbags_is_read_and_played_remapped(graph, tmp_path):
    space = f'/{graph.namespace}'
    sqlite_bag(tmp_path / 'bag', space)
    with BagReader(tmp_path / 'bag') as reader:
        assert (reader.storage, reader.message_count) == ('sqlite3', 20)
        assert (reader.start_time, reader.end_time) == (10 ** 9, 10 ** 9 + 19 * 10 ** 7)
        assert len(list(reader.messages(start=10 ** 9 + 10 ** 8))) == 10
        assert verify_bag(reader).good
    heard = []
    graph.probe.create_subscription(String, 'spoken', heard.append, 100)
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), wait_for_subscribers=10.0,
                        remaps=f'{space}/words:={space}/spoken')
    graph.spin_until(lambda: len(heard) == 20, 10, 'words')
    assert [one.data for one in heard] == [f'word {number}' for number in range(20)]
    assert player.process.wait(30) == 0


def test_offset_duration_loop_and_clock(graph, tmp_path):
    space = f'/{graph.namespace}'
    sqlite_bag(tmp_path / 'bag', space)
    heard, clocks = [], []
    graph.probe.create_subscription(String, 'words', heard.append, 1000)
    graph.probe.create_subscription(Clock, '/clock', clocks.append, 1000)
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), wait_for_subscribers=10.0,
                        start_offset=0.05, duration=0.1, loop=True, clock_rate=100.0)
    graph.spin_until(lambda: len(heard) >= 25, 10, 'three rounds')
    assert [one.data for one in heard[:25]] == [f'word {5 + number % 10}'
                                                for number in range(25)]
    stamps = [one.clock.sec * 10 ** 9 + one.clock.nanosec for one in clocks]
    assert stamps
    assert all(10 ** 9 + 5e7 <= stamp <= 10 ** 9 + 15e7 for stamp in stamps)
    assert stop(player) == 0


def test_a_stretch_without_messages_is_not_played_for_ever(graph, tmp_path):
    sqlite_bag(tmp_path / 'bag', f'/{graph.namespace}')
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), wait_for_subscribers=0.0,
                        start_offset=1000.0, loop=True)
    assert player.process.wait(30) == 0
    assert any('there is no message in what is to be played' in line for line in player.words)
    assert any('0 messages played' in line for line in player.words)


def test_pause_and_step_services(graph, tmp_path):
    space = f'/{graph.namespace}'
    sqlite_bag(tmp_path / 'bag', space)
    heard = []
    graph.probe.create_subscription(String, 'words', heard.append, 100)
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), wait_for_subscribers=10.0,
                        start_paused=True)
    step = graph.probe.create_client(Trigger, 'bag_player_node/step')
    pause = graph.probe.create_client(SetBool, 'bag_player_node/pause')
    for client in (step, pause):
        graph.spin_until(client.service_is_ready, 10, 'service')
    graph.spin(0.2)
    assert heard == []
    for expected in (['word 0'], ['word 0', 'word 1']):
        future = step.call_async(Trigger.Request())
        graph.spin_until(future.done, 5, 'answer')
        assert future.result().success
        graph.spin_until(lambda so_far=expected: len(heard) == len(so_far), 5, 'one word')
        assert [one.data for one in heard] == expected
    future = pause.call_async(SetBool.Request(data=False))
    graph.spin_until(future.done, 5, 'answer')
    graph.spin_until(lambda: len(heard) == 20, 5, 'the rest')
    assert player.process.wait(30) == 0


@pytest.mark.parametrize(('module', 'parameters', 'told'), [
    (RECORDER[0], ['folder:={folder}'], 'exists already; nothing was overwritten'),
    (RECORDER[0], ['folder:={folder}/new', 'compression:=gzip'], "accepted: one of 'none'"),
    (RECORDER[0], ['folder:={folder}/new', 'chunk_bytes:=3'], 'accepted: 1024 to'),
    (RECORDER[0], ['folder:={folder}/new', 'provenance:=text'], 'provenance is not JSON'),
    (RECORDER[0], ['folder:={folder}/new', 'compresion:=lz4'], "did you mean 'compression'"),
    (PLAYER[0], ['bag:={folder}/none'], 'does not exist'),
    (PLAYER[0], ['bag:={folder}'], 'has no metadata.yaml'),
    (PLAYER[0], ['rate:=1.0'], 'no bag was given'),
    (RECORDER[0], ['folder:={folder}/new', 'topics:="a b"'], "'a b' cannot be the name of a"),
    (RECORDER[0], ['folder:={folder}/new', 'exclude:="1"'], 'cannot be the name of a topic'),
    (RECORDER[0], ['folder:={folder}/new', 'topics:=","'], "topics is ',', which chooses none"),
    (RECORDER[0], ['folder:={folder}/new', "provenance:='{{\"a\": \"\\ud800\"}}'"], 'surrogate'),
])
def test_what_is_wrong_ends_the_node_with_one_line(tmp_path, module, parameters, told):
    command = [sys.executable, '-m', module, '--ros-args']
    for parameter in parameters:
        command += ['-p', parameter.format(folder=tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert done.returncode == 2
    assert done.stderr.startswith('error: ')
    assert told in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_a_time_that_a_clock_cannot_say_is_not_played_as_another(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/word', 'std_msgs/msg/String', [])
        writer.write(topic, 2 ** 31 * 10 ** 9, 0, serialized('std_msgs/msg/String', 'late'))
    done = subprocess.run(
        [sys.executable, '-m', PLAYER[0], '--ros-args', '-p', f'bag:={tmp_path / "bag"}', '-p',
         'clock_rate:=10.0'], capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert done.returncode == 2
    assert '/clock can say 2147483648 s at most' in done.stderr
    assert done.stderr.count('\n') == 1


def test_a_topic_that_is_listened_to_anew_brings_nothing_twice_and_says_what_is_not_counted():
    kind = Kind(True, True)
    topic = RecordedTopic('/word', 'std_msgs/msg/String', object, latched=True, depth=100)
    topic.listen_with({kind: object()})
    assert not topic.is_repeat(1, 1)
    topic.sequence = 1
    topic.publishers = frozenset([b'one'])
    topic.listen_anew({kind: object()})
    # the publisher counts: a gap tells what was lost
    assert not topic.unsure
    # and sends what it keeps once more
    assert topic.is_repeat(1, 1)
    assert not topic.is_repeat(2, 2)
    for publishers, sequence in ((frozenset([b'one', b'two']), 2), (frozenset([b'one']), 0)):
        topic.unsure = False
        topic.publishers, topic.sequence = publishers, sequence
        topic.listen_anew({kind: object()})
        assert topic.unsure


def test_a_recorder_that_joins_a_drive_calls_nothing_lost(graph, tmp_path):
    graph.node(*POLICY, model='random')
    graph.node(*SIM, seed=11)
    graph.listen(topics.STEP)
    graph.spin_until(lambda: len(graph.messages['step']) > 300, 40, 'a drive under way')
    # two, because whether discovery or the first message comes first is a matter of luck
    for name in ('one', 'two'):
        recorder = start_recorder(graph, tmp_path / name)
        graph.messages['step'].clear()
        graph.spin_until(lambda: len(graph.messages['step']) > 500, 40, 'more of it')
        assert stop(recorder) == 0
        assert any('lost: none' in line for line in recorder.words), recorder.words


def said(child):
    """Return everything that a node has said."""
    return child.log.read_text().splitlines() if child.log.exists() else []


def publish_for(seconds, *talks):
    """Let publishers send a message each 20 ms; return how often."""
    began, count = time.monotonic(), 0
    while time.monotonic() - began < seconds:
        for publisher, message in talks:
            publisher.publish(message)
        count += 1
        time.sleep(0.02)
    return count


def announce(graph, *words):
    child = graph.start('forger', [sys.executable, str(ROOT / 'tests/forger.py'), *words])
    wait_for(lambda: 'announced' in child.words, 10, 'forged types')


def test_types_that_are_no_messages_are_named_once_and_the_rest_is_recorded(graph, tmp_path):
    space = f'/{graph.namespace}'
    announce(graph, f'{space}/evil')
    recorder = start_recorder(graph, tmp_path / 'bag')

    def refused():
        return [line for line in said(recorder) if 'is not recorded' in line]
    wait_for(lambda: len(refused()) >= len(TYPES), 10, 'all of them')
    words = graph.probe.create_publisher(String, 'words', 10)
    wait_for(words.get_subscription_count, 10, 'recorder')
    publish_for(1.5, (words, String(data='sane')))
    assert stop(recorder) == 0
    assert len(refused()) == len(TYPES)
    assert all('not installed here' in line and len(line) < 300 for line in refused())
    assert '\x1b' not in recorder.log.read_text()
    assert not any('recording' in line and 'evil' in line for line in said(recorder))
    with BagReader(tmp_path / 'bag') as reader:
        assert not any('evil' in name for name in reader.topics)
        assert reader.topics[f'{space}/words'].message_count > 50


def test_a_type_whose_name_is_no_text_does_not_hide_the_other_topics(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    policy = graph.node(*POLICY, model='random')
    announce(graph, f'/{graph.namespace}/image_raw', 'no_text')
    wait_for(lambda: any('cannot be read' in line for line in said(recorder)), 10, 'notice')
    words = graph.probe.create_publisher(String, 'words', 10)
    wait_for(words.get_subscription_count, 10, 'recorder')
    publish_for(1.0, (words, String(data='here')))
    wait_for(lambda: any('driving with' in line for line in said(policy)), 20, 'policy')
    time.sleep(1.5)
    assert stop(recorder) == 0
    assert policy.process.poll() is None, said(policy)
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.topics[f'/{graph.namespace}/words'].message_count > 10


def test_each_kind_of_publisher_is_heard_and_nothing_comes_twice(graph, tmp_path):
    space = f'/{graph.namespace}'
    recorder = start_recorder(graph, tmp_path / 'bag')
    create = graph.probe.create_publisher
    reliable = create(String, 'words', QoSProfile(
        depth=10, deadline=Duration(seconds=5), lifespan=Duration(seconds=60)))
    wait_for(reliable.get_subscription_count, 10, 'recorder')
    before = publish_for(1.0, (reliable, String(data='reliable')))
    # they come later, and ask nothing of the first
    loose = create(String, 'words', qos_profile_sensor_data)
    latched = create(String, 'words', QoSProfile(
        depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=9)))
    for number in range(3):
        latched.publish(String(data=f'latched {number}'))
    wait_for(lambda: loose.get_subscription_count() and latched.get_subscription_count() > 1,
             10, 'a subscription of each kind')
    after = publish_for(1.0, (reliable, String(data='reliable')), (loose, String(data='loose')))
    time.sleep(0.2)
    assert stop(recorder, signal.SIGHUP) == 0
    with BagReader(tmp_path / 'bag') as reader:
        counts = Counter(deserialize_message(bytes(one.data), String).data
                         for one in reader.messages([f'{space}/words']))
        topic, = [one for one in reader.metadata.topics if one.name == f'{space}/words']
    assert counts.pop('reliable') == before + after
    assert after - 3 <= counts.pop('loose') <= after
    assert counts == {f'latched {number}': 1 for number in range(3)}
    assert [(one['reliability'], one['durability'], one['liveliness'], one['deadline']['sec'],
             one['lifespan']['sec'], one['liveliness_lease_duration']['sec'])
            for one in topic.qos] == [
        ('reliable', 'volatile', 'automatic', 5, 60, 9223372036),
        ('best_effort', 'volatile', 'automatic', 9223372036, 9223372036, 9223372036),
        ('reliable', 'transient_local', 'manual_by_topic', 9223372036, 9223372036, 9)]


def test_what_waits_in_dds_when_a_recorder_is_stopped_is_in_the_bag(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    publishers = [graph.publisher(topic) for topic in (topics.STEP, topics.CMD_VEL)]
    wait_for(lambda: all(one.get_subscription_count() for one in publishers), 10, 'recorder')
    # the recorder may find the publishers later than they find it
    time.sleep(1.0)
    # a machine so busy that the recorder does not get to run at all
    recorder.process.send_signal(signal.SIGSTOP)
    for number in range(1000):
        publishers[0].publish(JointState(name=['number'], position=[float(number)]))
        publishers[1].publish(graph_twist())
    recorder.process.send_signal(signal.SIGTERM)
    recorder.process.send_signal(signal.SIGCONT)
    assert recorder.process.wait(30) == 0
    assert any('lost: none' in line for line in said(recorder)), said(recorder)
    with BagReader(tmp_path / 'bag') as reader:
        for name in ('step', 'cmd_vel'):
            assert reader.topics[f'/{graph.namespace}/{name}'].message_count == 1000
        assert json.loads(reader.custom_data['lost_messages']) == {}


def remove(recorder, folder):
    shutil.rmtree(folder)


def replace(recorder, folder):
    (folder / 'bag_0.mcap').unlink()
    (folder / 'bag_0.mcap').write_bytes(bytes(1 << 20))


def fill_up(recorder, folder):
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (10_000, 10_000))


@pytest.mark.parametrize(('break_it', 'reason'), [
    (remove, 'bag_0.mcap was removed'), (replace, 'bag_0.mcap was removed, moved or replaced'),
    (fill_up, 'File too large')])
def test_a_recorder_that_no_longer_writes_says_so_and_ends(graph, tmp_path, break_it, reason):
    recorder = start_recorder(graph, tmp_path / 'bag', chunk_seconds=0.1)
    graph.listen(topics.DIAGNOSTICS)
    steps = graph.publisher(topics.STEP)
    wait_for(steps.get_subscription_count, 10, 'recorder')
    publish_for(0.5, (steps, JointState(name=['value'], position=[1.0])))
    break_it(recorder, tmp_path / 'bag')
    until = time.monotonic() + 10
    while recorder.process.poll() is None and time.monotonic() < until:
        publish_for(0.1, (steps, JointState(name=['value'], position=[1.0])))
    assert recorder.process.poll() == 2
    told = [line for line in said(recorder) if line.startswith('error:')]
    assert len(told) == 1
    assert reason in told[0]
    assert not any('Traceback' in line for line in said(recorder))
    graph.spin(0.1)
    levels = [status.level for message in graph.messages[topics.DIAGNOSTICS.name]
              for status in message.status if status.name.endswith(RECORDER[1])]
    assert DiagnosticStatus.ERROR in levels


def test_a_recorder_that_is_stopped_without_its_bag_does_not_call_that_a_success(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    recorder.process.send_signal(signal.SIGSTOP)
    remove(recorder, tmp_path / 'bag')
    recorder.process.send_signal(signal.SIGINT)
    recorder.process.send_signal(signal.SIGCONT)
    assert recorder.process.wait(30) == 2
    assert sum('was removed' in line for line in said(recorder)) == 1


def test_a_flood_of_large_images_is_bounded_and_counted(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag', cache_bytes=4 << 20)
    graph.listen(topics.DIAGNOSTICS)
    camera, steps = graph.publisher(topics.IMAGE), graph.publisher(topics.STEP)
    wait_for(lambda: camera.get_subscription_count() and steps.get_subscription_count(), 60,
             'recorder')
    before = memory(recorder)
    # of 600 MB DDS would keep each byte
    flood = Image(height=4000, width=4000, encoding='rgb8', step=12_000, data=bytes(48_000_000))
    most = 0
    for _ in range(13):
        camera.publish(flood)
        most = max(most, memory(recorder) - before)
    # a publisher that is gone sends nothing again
    graph.spin_until(lambda: f'lost_/{graph.namespace}/image_raw' in graph.health(RECORDER[1]), 60,
                     'losses that are counted')
    graph.probe.destroy_publisher(camera)
    # while its memory is too large a recorder listens anew, also to what it has not heard yet
    graph.spin(2.5)
    for _ in range(50):
        steps.publish(JointState(name=['value'], position=[1.0]))
        time.sleep(0.01)
    assert stop(recorder) == 0
    assert most < 500 << 20
    with BagReader(tmp_path / 'bag') as reader:
        assert json.loads(reader.custom_data['lost_messages'])[f'/{graph.namespace}/image_raw']
        assert reader.topics[f'/{graph.namespace}/step'].message_count == 50


def memory(child):
    """Return the resident bytes of a node."""
    status = Path(f'/proc/{child.process.pid}/status').read_text()
    return int(re.search(r'VmRSS:\s+(\d+)', status)[1]) << 10


def string_bag(folder, topics_of):
    """Write 20 words a topic, 10 ms apart, with the profiles given for it."""
    with BagWriter(folder) as writer:
        numbers = [writer.add_topic(name, 'std_msgs/msg/String', profiles,
                                    schema=Schema(type_name, '', '', ''))
                   for name, (type_name, profiles) in topics_of.items()]
        for count in range(20):
            for number in numbers:
                time_ = 10 ** 9 + count * 10 ** 7
                writer.write(number, time_, time_, serialized('std_msgs/msg/String', f'{count}'))
    return folder


def test_a_player_offers_what_was_recorded_and_says_who_cannot_hear_it(graph, tmp_path):
    space = f'/{graph.namespace}'
    text = 'std_msgs/msg/String'
    loose = {**offered_qos(reliable=False), 'deadline': {'sec': 3, 'nsec': 0},
             'lifespan': {'sec': 7, 'nsec': 0}, 'liveliness': 'manual_by_topic',
             'liveliness_lease_duration': {'sec': 9, 'nsec': 0}}
    string_bag(tmp_path / 'bag', {
        f'{space}/loose': (text, [loose]), f'{space}/quiet': (text, [offered_qos()]),
        f'{space}/both': (text, [offered_qos(), loose])})
    heard = defaultdict(list)
    listen = graph.probe.create_subscription
    listen(String, 'loose', heard['loose'].append, 100)
    listen(String, 'both', heard['both'].append, 100)
    graph.listen(topics.DIAGNOSTICS)
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), start_paused=True)
    graph.spin_until(lambda: 'is not heard' in graph.health(PLAYER[1]).get('summary', ''), 20,
                     'the reason in the diagnostics')
    offer, = graph.probe.get_publishers_info_by_topic(f'{space}/loose')
    assert (offer.qos_profile.reliability, offer.qos_profile.liveliness) == (
        ReliabilityPolicy.BEST_EFFORT, LivelinessPolicy.MANUAL_BY_TOPIC)
    assert [one.nanoseconds // 10 ** 9 for one in (
        offer.qos_profile.deadline, offer.qos_profile.lifespan,
        offer.qos_profile.liveliness_lease_duration)] == [3, 7, 9]
    pause = graph.probe.create_client(SetBool, 'bag_player_node/pause')
    graph.spin_until(pause.service_is_ready, 10, 'service')
    pause.call_async(SetBool.Request(data=False))
    graph.spin_until(lambda: player.process.poll() is not None, 20, 'the end')
    assert player.process.poll() == 0
    graph.spin(0.2)
    # of several publishers the strongest, so that a reliable subscriber of one hears it
    assert (len(heard['loose']), len(heard['both'])) == (0, 20)
    # once in ten seconds
    assert 0 < sum('loose is not heard: QoS of' in line for line in said(player)) < 5
    last = said(player)[-1]
    assert f'nobody listened to {space}/loose, {space}/quiet' in last


def test_a_player_leaves_out_what_cannot_be_played(graph, tmp_path):
    space = f'/{graph.namespace}'
    string_bag(tmp_path / 'bag', {
        f'{space}/words': ('std_msgs/msg/String', []), '/[/x]': ('std_msgs/msg/String', []),
        '/not a name': ('std_msgs/msg/String', []), '/a': ('os/path/join', []),
        '/b': ('std_msgs/msg/_bool', []), '/c': ('rclpy/node/Node', []),
        '/d': ('std_srvs/srv/SetBool', []), '/e': ('antigravity/x/Y', [])})
    heard = []
    graph.probe.create_subscription(String, 'words', heard.append, 100)
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'))
    graph.spin_until(lambda: player.process.poll() is not None, 20, 'the end')
    assert player.process.poll() == 0
    assert len(heard) == 20
    assert sum('is not played' in line for line in said(player)) == 7
    assert not any('Traceback' in line for line in said(player))


def test_a_bag_is_played_as_fast_as_a_driver_answers(graph, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=60)
    graph.listen(topics.CMD_VEL)
    graph.node(*POLICY, model='random')
    graph.spin_until(lambda: graph.probe.count_publishers('cmd_vel'), 30, 'policy')
    graph.spin(1.0)
    player = graph.node(
        *PLAYER, bag=str(bag), prefix=f'/{graph.namespace}', wait_for_subscribers=20.0,
        topics='/image_raw,/cmd_vel,/q_values', answer_timeout=10.0)
    graph.spin_until(lambda: player.process.poll() is not None, 40, 'the end')
    assert '0 images were not answered' in said(player)[-1]
    assert re.search(r'; \d+ q_values compared: the same action in ', said(player)[-1])
    with BagReader(bag) as reader:
        images = reader.topics['/image_raw'].message_count
    # each image has its answer, and nobody played the recorded ones
    assert len(graph.messages['cmd_vel']) == images == 61


@pytest.mark.parametrize('clock', [True, False])
def test_a_recorder_on_simulation_time_logs_by_it_if_there_is_any(graph, tmp_path, clock):
    recorder = start_recorder(graph, tmp_path / 'bag', use_sim_time=True, exclude='/clock')
    words = graph.probe.create_publisher(String, 'words', 10)
    clocks = graph.publisher(topics.CLOCK)
    wait_for(lambda: words.get_subscription_count() and clocks.get_subscription_count(), 10,
             'recorder')
    words.publish(String(data='before any clock'))
    for second in range(100, 110):
        if clock:
            clocks.publish(Clock(clock=Time(sec=second)))
            time.sleep(0.02)
        words.publish(String(data='a'))
        words.publish(String(data='b'))
        time.sleep(0.02)
    assert stop(recorder) == 0
    with BagReader(tmp_path / 'bag') as reader:
        times = [one.log_time for one in reader.messages([f'/{graph.namespace}/words'])]
        assert '/clock' not in reader.topics
    if clock:
        assert times == [100 * 10 ** 9] + [second * 10 ** 9 for second in range(100, 110)
                                           for _ in 'ab']
    else:
        assert len(times) == 21
        assert min(times) > 10 ** 18
        assert any('nobody published /clock' in line for line in said(recorder))


def test_as_fast_as_possible_is_no_faster_than_the_subscribers(graph, tmp_path):
    small_bag(tmp_path / 'bag', messages=4000)
    recorder = start_recorder(graph, tmp_path / 'again', topics='reward,clock')
    player = graph.node(*PLAYER, bag=str(tmp_path / 'bag'), rate=0.0, topics='/reward,/clock',
                        prefix=f'/{graph.namespace}', wait_for_subscribers=10.0)
    assert player.process.wait(60) == 0
    assert stop(recorder) == 0
    assert 'lost: none' in said(recorder)[-1]
    with BagReader(tmp_path / 'again') as reader:
        assert {name: topic.message_count for name, topic in reader.topics.items()} == {
            f'/{graph.namespace}/reward': 4000, f'/{graph.namespace}/clock': 4000}


def test_a_publisher_that_is_faster_than_the_recorder_keeps_nobody_else_from_it(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    flood = graph.start('flood', [sys.executable, '-c', FLOOD, f'/{graph.namespace}/flood'])
    words = graph.probe.create_publisher(String, 'words', 100)
    wait_for(lambda: any('/flood' in line for line in said(recorder)), 20, 'the flood')
    wait_for(words.get_subscription_count, 10, 'recorder')
    graph.listen(topics.DIAGNOSTICS)
    sent = publish_for(2.0, (words, String(data='sane')))
    kill(flood)
    # a busy machine needs a while for what waits in the middleware
    counts = [0, 0]

    def caught_up():
        counts.append(int(graph.health(RECORDER[1]).get('messages', 0)))
        graph.spin(1.2)
        # the diagnostics themselves are recorded
        return counts[-1] > 0 and counts[-1] - counts[-2] < 20

    graph.spin_until(caught_up, 30, 'everything is taken')
    assert stop(recorder) == 0
    with BagReader(tmp_path / 'bag') as reader:
        found = verify_bag(reader)
        assert found.good, found.problems
        assert reader.topics[f'/{graph.namespace}/words'].message_count == sent
        assert reader.topics[f'/{graph.namespace}/flood'].message_count > 100
        lost = json.loads(reader.custom_data['lost_messages'])
    assert set(lost) <= {f'/{graph.namespace}/flood'}


FLOOD = """
import rclpy, sys
from std_msgs.msg import Int64
rclpy.init()
publisher = rclpy.create_node('flood').create_publisher(Int64, sys.argv[1], 100)
message = Int64()
while True:
    publisher.publish(message)
"""


def test_what_a_node_published_last_is_in_the_bag_though_the_recorder_was_busy(graph, tmp_path):
    recorder = start_recorder(graph, tmp_path / 'bag')
    speaker = graph.start('speaker', [
        sys.executable, '-c', SPEAKER, '--ros-args', '-r', f'__ns:=/{graph.namespace}'])
    wait_for(lambda: 'heard' in said(speaker), 15, 'a subscription')
    recorder.process.send_signal(signal.SIGSTOP)
    wait_for(lambda: 'over' in said(speaker), 10, 'the last message')
    time.sleep(0.3)
    recorder.process.send_signal(signal.SIGCONT)
    assert speaker.process.wait(30) == 0
    assert stop(recorder) == 0
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.topics[f'/{graph.namespace}/cmd_vel'].message_count == 1500


SPEAKER = """
import dataclasses, sys, time
from geometry_msgs.msg import TwistStamped
from msgs_bridge import topics
from msgs_bridge.node_process import Finished, run_node
from msgs_bridge.node_shell import NodeShell

@dataclasses.dataclass(frozen=True)
class Settings:
    pass

class Speaker(NodeShell):
    def __init__(self):
        super().__init__('speaker', Settings)
        self.twists = self.publisher(topics.CMD_VEL)
        self.create_timer(0.1, self.speak)

    def speak(self):
        if not self.twists.get_subscription_count():
            return
        print('heard')
        time.sleep(1)
        for _ in range(1500):
            self.twists.publish(TwistStamped())
        print('over')
        raise Finished

run_node(Speaker)
"""


def test_the_command_records_and_plays(graph, tmp_path):
    space = f'/{graph.namespace}'
    string_bag(tmp_path / '2026_11_25', {'/words': ('std_msgs/msg/String', [offered_qos()])})
    recorder = graph.start('command', [
        sys.executable, '-m', 'carracing_dqn.bringup', 'bag', 'record', str(tmp_path / '1e5'),
        '--topics', f'{space}/words'])
    wait_for(lambda: any('recording' in line for line in said(recorder)), 20, 'recording')
    played = carracing('bag', 'play', str(tmp_path / '2026_11_25'), '--prefix', space,
                       '--wait-for-subscribers', '10')
    assert played.returncode == 0, played.stderr
    assert '20 messages played' in played.stderr
    time.sleep(0.2)
    assert stop(recorder) == 0
    with BagReader(tmp_path / '1e5') as reader:
        assert reader.topics[f'{space}/words'].message_count == 20
