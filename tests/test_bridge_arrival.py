# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that wake a thread without an executor, over real DDS."""
import dataclasses
import platform
import os
import subprocess
import sys
import threading
import time

from graph_probe import ROOT
from msgs_bridge import topics
from msgs_bridge.transport.arrival import Bell
from msgs_bridge.node_shell import NodeShell
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
    bell.ring_for(subscription.subscription)
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
    subscription = node.subscription(topics.REWARD, [].append, polled=True)
    for number in range(3):
        publisher.publish(Float32(data=float(number)))
    bell = Bell()
    bell.ring_for(subscription.subscription)
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


@pytest.mark.skipif(
    platform.machine() not in ('x86_64', 'aarch64'), reason='number of the system call unknown')
def test_short_time_slices_keep_priority_and_chosen_policies():
    code = """
import ctypes, os, threading
from msgs_bridge.transport.time_slices import _ATTRIBUTES, shorten_time_slices
def attributes(thread):
    number = {'x86_64': 315, 'aarch64': 275}[os.uname().machine]
    memory = ctypes.create_string_buffer(_ATTRIBUTES.size)
    assert not ctypes.CDLL(None).syscall(
        ctypes.c_long(number), ctypes.c_long(thread), memory,
        ctypes.c_long(_ATTRIBUTES.size), ctypes.c_long(0))
    _, policy, _, nice, _, runtime, *_ = _ATTRIBUTES.unpack(memory.raw)
    return policy, nice, runtime
ready, done = threading.Event(), threading.Event()
def be_batch():
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    ready.set()
    done.wait()
other = threading.Thread(target=be_batch)
other.start()
ready.wait()
os.nice(3)
shorten_time_slices()
print(*attributes(0), os.sched_getscheduler(other.native_id))
done.set()
"""
    said = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, cwd=ROOT, check=True)
    policy, nice, runtime, other = map(int, said.stdout.split())
    # 3 is SCHED_BATCH, and the tests themselves may have been started nicely
    assert (policy, nice, other) == (0, min(os.nice(0) + 3, 19), 3)
    # older kernels keep no slice
    assert runtime in (0, 100_000)
