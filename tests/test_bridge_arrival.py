# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that wake a thread without an executor, over real DDS."""
import dataclasses
import threading
import time

from msgs_bridge import topics
from msgs_bridge.arrival import Bell
from msgs_bridge.node_shell import NodeShell, PolledGroup
from msgs_bridge.qos import qos_profile
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float32

FOREVER = 60


@dataclasses.dataclass(frozen=True)
class NoSettings:
    """A node without parameters."""


@pytest.fixture
def node():
    """Return a node in this process."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = NodeShell('arrival', NoSettings)
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_bell_rings_for_what_arrives_and_not_before(node):
    heard = []
    publisher = node.publisher(topics.REWARD)
    subscription = node.subscription(topics.REWARD, heard.append, polled=True)
    bell = Bell()
    bell.ring_for(subscription)
    now = time.monotonic()
    bell.wait(now + 0.05)
    assert time.monotonic() >= now + 0.05
    assert not node.take(subscription)
    # long waits asleep, then short ones awake
    for number, pause in enumerate([0.1, 0.1, 0, 0, 0, 0]):
        timer = threading.Timer(pause, publisher.publish, [Float32(data=float(number))])
        timer.start()
        now = time.monotonic()
        while not node.take(subscription):
            bell.wait(now + FOREVER)
        timer.join()
    assert [message.data for message in heard] == [0, 1, 2, 3, 4, 5]


def test_a_bell_rings_for_what_arrived_before_anybody_waited(node):
    publisher = node.publisher(topics.REWARD)
    subscription = node.create_subscription(
        Float32, topics.REWARD.name, print, qos_profile(topics.REWARD),
        callback_group=PolledGroup())
    for number in range(3):
        publisher.publish(Float32(data=float(number)))
    bell = Bell()
    bell.ring_for(subscription)
    until = time.monotonic() + FOREVER
    bell.wait(until)
    assert time.monotonic() < until
    assert [node.take(subscription) for _ in range(4)] == [True, True, True, False]


def test_the_executor_has_its_turn_however_fast_eager_messages_come(node):
    publisher = node.publisher(topics.REWARD)
    heard = []

    def answer_itself(message):
        heard.append(message.data)
        publisher.publish(Float32(data=message.data + 1))

    node.subscription(topics.REWARD, answer_itself, eager=True)
    publisher.publish(Float32(data=0.0))
    for _ in range(5):
        node.take_eagerly(0.01)
    assert heard == list(range(len(heard)))
    assert len(heard) > 5
