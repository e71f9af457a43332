# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What every node has from the shell, over real DDS: it hears, and says what it cannot hear."""
from array import array
import dataclasses
from pathlib import Path
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from msgs_bridge import topics
from msgs_bridge.errors import SettingsError
from msgs_bridge.matching import (
    as_known, NamesHidden, nodes_of, publishers_of, services_of, topics_of,
)
from msgs_bridge.node_shell import NodeShell
from msgs_bridge.settings import setting
from msgs_bridge.transport import arrival
import pytest
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from shell_pair import Pair
from std_msgs.msg import UInt8MultiArray

BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
WaitSet = rclpy_implementation.WaitSet


@dataclasses.dataclass(frozen=True)
class Settings:
    """Parameters of a made-up node."""

    run: str = setting('', 'name of a run')
    rate: float = setting(1.0, 'how often', low=0.1, high=100.0, live=True)
    most: float = setting(50.0, 'how often at most', low=0.1, high=100.0, live=True)

    def __post_init__(self) -> None:
        """Check what concerns more than one value; raises SettingsError."""
        if self.rate > self.most:
            raise SettingsError(f'rate is {self.rate:g}; accepted: up to most, {self.most:g}')


class Listener(NodeShell):
    """Hears images, rewards and weights; publishes twists."""

    how: dict[str, bool] = {}

    def __init__(self) -> None:
        super().__init__('listener', Settings)
        self.heard: list = []
        self.images = self.subscription(topics.IMAGE, self.heard.append, **self.how)
        self.twists = self.publisher(topics.CMD_VEL)


class Poller(Listener):
    """Takes images when asked."""

    how = {'polled': True}


class Newest(Listener):
    """Takes the newest image when asked."""

    how = {'polled': True, 'newest': True}


class Eager(Listener):
    """Hears images without the executor."""

    how = {'eager': True}


@pytest.fixture
def pair():
    """Return two nodes in this process."""
    pair = Pair()
    yield pair
    pair.stop()


@pytest.mark.parametrize('kind', [Listener, Poller, Eager])
def test_a_best_effort_camera_is_heard(pair, kind):
    node = pair.start(kind)
    camera = pair.offer(Image, 'image_raw', reliability=BEST_EFFORT)
    pair.spin_until(
        lambda: node.heard, 5, 'an image', lambda: (
            camera.publish(Image()), node.take(node.images) if kind is Poller else None,
            node.take_eagerly(0.01) if node.eager else None))
    assert node.images.qos.reliability == BEST_EFFORT
    # of two cameras each is heard
    other = pair.offer(Image, 'image_raw')
    pair.spin_until(lambda: other.get_subscription_count() == 1, 5, 'heard, too')
    # and when the first is gone what it did not offer is asked for again
    pair.other.destroy_publisher(camera)
    pair.spin_until(
        lambda: node.images.qos.reliability == ReliabilityPolicy.RELIABLE, 5, 'reliable')


def test_a_publisher_of_a_latched_topic_that_keeps_nothing_is_heard(pair):
    node = pair.start(Listener)
    heard = []
    node.subscription(topics.WEIGHTS, heard.append)
    weights = pair.offer(UInt8MultiArray, 'weights')
    pair.spin_until(
        lambda: heard, 5, 'weights', lambda: weights.publish(UInt8MultiArray(data=[1])))


def test_a_latched_message_reaches_who_comes_later(pair):
    node = pair.start(Listener)
    weights = pair.offer(
        UInt8MultiArray, 'weights', durability=DurabilityPolicy.TRANSIENT_LOCAL)
    weights.publish(UInt8MultiArray(data=[1]))
    heard = []
    node.subscription(topics.WEIGHTS, heard.append)
    pair.spin_until(lambda: heard, 5, 'weights')


def test_qos_overrides_are_those_of_rclpy(pair):
    node = pair.start(
        Listener,
        '-p', f'qos_overrides.{pair.space}/image_raw.subscription.reliability:=best_effort',
        '-p', f'qos_overrides.{pair.space}/image_raw.subscription.depth:=7',
        '-p', f'qos_overrides.{pair.space}/cmd_vel.publisher.durability:=transient_local')
    asked = node.get_subscriptions_info_by_topic(f'{pair.space}/image_raw')[0].qos_profile
    offered = node.get_publishers_info_by_topic(f'{pair.space}/cmd_vel')[0].qos_profile
    assert asked.reliability == BEST_EFFORT and node.images.qos.depth == 7
    assert offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
    # what somebody has chosen stays, whatever is offered
    camera = pair.offer(Image, 'image_raw')
    pair.spin_until(lambda: node.heard, 5, 'an image', lambda: camera.publish(Image()))
    pair.spin_until(lambda: len(pair.statuses) > 2, 5, 'some time')
    assert node.images.qos.reliability == BEST_EFFORT


@pytest.mark.parametrize('override', [
    'image_raw.subscription.reliability:=perhaps', 'image_raw.subscription.depth:=many',
    'image_raw.subscription.depth:=-3', 'cmd_vel.publisher.history:=some',
    'cmd_vel.publisher.reliability:=2', 'cmd_vel.publisher.depth:=99999999999',
    'image_raw.subscription.depth:=99999999999'])
def test_an_override_that_there_is_not_is_refused_in_a_line(pair, override):
    with pytest.raises(SettingsError, match='qos_overrides'):
        pair.start(Listener, '-p', f'qos_overrides.{pair.space}/{override}')


def test_what_does_not_fit_is_named_on_both_sides(pair):
    pair.start(
        Listener,
        '-p', f'qos_overrides.{pair.space}/image_raw.subscription.reliability:=reliable')
    pair.offer(Image, 'image_raw', reliability=BEST_EFFORT)
    pair.other.create_subscription(Twist, 'cmd_vel', lambda _: None, 10)
    pair.other.create_subscription(
        DiagnosticArray, '/diagnostics', lambda _: None,
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    pair.spin_until(lambda: pair.status and 'image_raw' in pair.status.message, 5, 'a warning')
    assert pair.status.level == DiagnosticStatus.WARN
    said = pair.status.message
    assert f'QoS of {pair.space}/other does not match: Best effort publisher' in said
    assert f'{pair.space}/other takes geometry_msgs/msg/Twist, this node publishes' in said
    assert 'Volatile publisher and transient local subscription' in said


def test_only_the_newest_image_is_taken_and_the_others_are_counted(pair):
    node = pair.start(Newest)
    camera = pair.offer(Image, 'image_raw', depth=50)
    pair.spin_until(lambda: camera.get_subscription_count() == 1, 5, 'a subscription')
    for width in range(30):
        camera.publish(Image(width=width))
    pair.spin_until(lambda: node.heard and node.heard[-1].width == 29, 5, 'the newest',
                    lambda: node.take(node.images))
    assert node.images.counts['skipped'] + len(node.heard) == 30 and len(node.heard) < 10


FLOOD = """
import sys, time, rclpy
from array import array
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node('flood')
camera, other = (node.create_publisher(Image, sys.argv[1], depth) for depth in (100, 500))
while camera.get_subscription_count() < 3:
    time.sleep(0.01)
image = Image(data=array('B', bytes(27648)))
for number in range(20_000):
    camera.publish(image)
    if number % 200 == 0:
        time.sleep(0.02)
        other.publish(image)
while True:
    other.publish(Image(width=2))
    time.sleep(0.05)
"""
SLOW_READER = """
import sys, time, rclpy
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node('slow')
node.create_subscription(Image, sys.argv[1], lambda _: time.sleep(0.002), 1)
rclpy.spin(node)
"""


@pytest.mark.parametrize('kind', [Poller, Eager])
def test_after_a_flood_everybody_hears_what_comes_then(pair, kind):
    """In shared memory four readers were seen to hear nothing more for good."""
    node = pair.start(kind)
    topic = f'{pair.space}/image_raw'
    processes = [subprocess.Popen([sys.executable, '-c', code, topic])
                 for code in (SLOW_READER, SLOW_READER, FLOOD)]

    def take():
        for _ in range(100):
            node.take(node.images)

    try:
        pair.spin_until(lambda: node.heard, 40, 'the flood', take)
        pair.spin_until(lambda: node.heard[-1].width == 2, 60, 'what comes after it', take)
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.parametrize('kind', [Poller, Eager])
def test_messages_that_somebody_else_takes_do_not_wake_the_executor(pair, monkeypatch, kind):
    node = pair.start(kind)
    camera = pair.offer(Image, 'image_raw')
    pair.spin_until(lambda: node.images.matched, 5, 'the camera is found')
    turns = []
    wait = WaitSet.wait
    monkeypatch.setattr(
        WaitSet, 'wait', lambda wait_set, *timeout: turns.append(0) or wait(wait_set, *timeout))
    pair.executors[0].spin_once(timeout_sec=0.2)
    quiet = len(turns)
    thread = threading.Thread(target=pair.executors[0].spin_once, kwargs={'timeout_sec': 0.5})
    for timer in node.timers:
        timer.cancel()
    thread.start()
    for _ in range(200):
        camera.publish(Image())
        time.sleep(0.001)
    thread.join()
    # it may notice once that there is a subscription with something in it
    assert len(turns) - quiet < 20, len(turns)


def test_what_waits_in_the_middleware_is_bounded_in_bytes(pair):
    node = pair.start(Poller)
    camera = pair.offer(Image, 'image_raw')
    image = Image(data=array('B', bytes(1 << 20)))

    def work():
        camera.publish(image)
        node.take(node.images)

    pair.spin_until(lambda: node.images.qos.depth == 64, 10, 'a depth for its size', work)
    before = len(node.heard)
    pair.spin_until(lambda: len(node.heard) > before + 3, 5, 'more images', work)
    image.data = array('B', bytes(1 << 10))
    pair.spin_until(lambda: node.images.qos.depth == topics.IMAGE.depth, 10, 'its depth', work)


def test_where_the_middleware_tells_nothing_the_executor_delivers(pair, monkeypatch):
    monkeypatch.setattr(arrival, 'FUNCTIONS', None)
    node = pair.start(Eager)
    assert not node.eager
    camera = pair.offer(Image, 'image_raw')
    pair.spin_until(lambda: node.heard, 5, 'an image', lambda: camera.publish(Image()))


def test_fast_transport_can_be_switched_off(pair):
    node = pair.start(Eager, '-p', 'fast_transport:=false')
    assert not node.eager
    camera = pair.offer(Image, 'image_raw')
    pair.spin_until(lambda: node.heard, 5, 'an image', lambda: camera.publish(Image()))


def test_timers_run_by_wall_time_although_nobody_publishes_a_clock(pair):
    node = pair.start(Listener, '-p', 'use_sim_time:=true')
    ticks = []
    node.create_timer(0.05, lambda: ticks.append(1))
    pair.spin_until(lambda: len(ticks) > 3 and pair.status, 5, 'timers and diagnostics')
    assert node.get_clock().now().nanoseconds == 0


def test_texts_from_outside_are_cut(pair):
    node = pair.start(Listener)
    node.counts['x'] = '\x1b]52;c;' + 'y' * 10000
    node.health = lambda: (DiagnosticStatus.OK, '\x1b[31m' + 'z' * 10000, {})
    pair.spin_until(lambda: pair.status, 5, 'diagnostics')
    assert len(pair.status.message) == 300 and '\x1b' not in pair.status.message
    assert len(pair.value('x')) == 200 and '\x1b' not in pair.value('x')


def test_what_is_warned_of_is_plain_wherever_it_comes_from(pair, monkeypatch):
    node = pair.start(Listener)
    logged = []
    monkeypatch.setattr(node, 'get_logger', lambda: SimpleNamespace(warn=logged.append))
    node.warn_of('reset_service', 'refused: \x1b]0;OWNED\x07' + 'x' * 3000 + '\nerror: no error')
    line, = logged
    assert line.isprintable() and len(line) < 300
    assert line.startswith('reset_service: refused: ?]0;OWNED?xxx')


def test_names_that_are_no_text_hide_no_more_than_themselves(pair):
    """Of no topic at all does rclpy tell then, and of no publisher of that one."""
    node = pair.start(Listener)
    forged = f'{pair.space}/forged'
    forger = subprocess.Popen(
        [sys.executable, str(Path(__file__).parent / 'forger.py'), forged, 'no_text'],
        stdout=subprocess.PIPE, text=True)
    try:
        assert forger.stdout.readline() == 'announced\n'
        camera = pair.offer(Image, 'image_raw')

        def hidden():
            try:
                topics_of(node)
            except NamesHidden:
                return True
            return False

        pair.spin_until(hidden, 10, 'a name that is no text')
        pair.spin_until(lambda: as_known(topics_of, node).get(camera.topic_name) == [
            'sensor_msgs/msg/Image'], 10, 'the topics of others')
        assert publishers_of(node, forged) == []
        assert len(publishers_of(node, camera.topic_name)) == 1
        assert ('other', pair.space) in nodes_of(node)
        assert f'{pair.space}/listener/get_parameters' in as_known(services_of, node)
    finally:
        forger.kill()
        forger.wait()
        forger.stdout.close()


def test_values_that_do_not_go_together_are_refused_at_run_time(pair):
    node = pair.start(Listener)
    refused, = node.set_parameters([Parameter('rate', value=60.0)])
    assert not refused.successful and refused.reason == 'rate is 60; accepted: up to most, 50'
    assert node.settings.rate == node.get_parameter('rate').value == 1.0
    taken = node.set_parameters_atomically(
        [Parameter('rate', value=60.0), Parameter('most', value=70.0)])
    assert taken.successful and node.settings.rate == 60.0


def test_a_publisher_that_is_gone_is_no_misfit():
    pair = Pair()
    try:
        shell = pair.start(Listener)
        shell.destroy_publisher(shell.twists)
        shell.publish_diagnostics()
    finally:
        pair.stop()
