# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Real nodes as processes and a node of the test's own that listens to them."""
from collections import defaultdict
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from carracing_dqn.bringup.processes import node_command, ProcessGroup
from msgs_bridge import topics
from msgs_bridge.images import image_to_array
from msgs_bridge.message_types import message_class
from msgs_bridge.named_values import read_named_values
from msgs_bridge.qos import qos_profile
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import read_step
from msgs_bridge.transitions import TransitionJoiner
from msgs_bridge.twists import read_command
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

ROOT = Path(__file__).resolve().parents[1]

# Waits are as long as a quiet machine could need; one that runs other things as well gets so many
# times as long. A wait costs time only where it fails.
PATIENCE = 3


def carracing(*words: str, timeout: float = 60, **options: object) -> subprocess.CompletedProcess:
    """Run the real command and return what it said."""
    return subprocess.run(
        [sys.executable, '-m', 'carracing_dqn.bringup', *words], capture_output=True, text=True,
        timeout=PATIENCE * timeout, cwd=ROOT, **options)


def start_carracing(*words: str) -> subprocess.Popen:
    """Start the real command in a session of its own."""
    return subprocess.Popen(
        [sys.executable, '-m', 'carracing_dqn.bringup', *words], stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, cwd=ROOT, start_new_session=True)


def wait_for(condition, seconds: float, what: str) -> None:
    """Wait until a condition holds."""
    seconds *= PATIENCE
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f'{what} within {seconds} s'
        time.sleep(0.02)


class Graph(ProcessGroup):
    """Nodes in a namespace of their own, and what they publish."""

    def __init__(self, folder: Path, namespace: str) -> None:
        """Join the graph; start nodes with `node`."""
        super().__init__(folder)
        self.namespace = namespace
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.probe = rclpy.create_node(
            'probe', context=self.context, namespace=f'/{namespace}',
            start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.probe)
        self.messages = defaultdict(list)

    def __exit__(self, *details: object) -> None:
        super().__exit__(*details)
        self.executor.shutdown(timeout_sec=1)
        self.probe.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def node(self, module: str, name: str, **parameters: object):
        """Start one of our nodes."""
        return self.start(name, node_command(module, parameters, self.namespace))

    def listen(self, *wanted: topics.Topic) -> None:
        """Collect the messages of topics into `messages`."""
        for topic in wanted:
            self.probe.create_subscription(
                message_class(topic.type_name), topic.name, self.messages[topic.name].append,
                qos_profile(topic, depth=topics.STALL_DEPTH))

    def publisher(self, topic: topics.Topic, type_name: str | None = None):
        """Publish on a topic as one of the nodes would."""
        return self.probe.create_publisher(
            message_class(type_name or topic.type_name), topic.name, qos_profile(topic))

    def spin_until(self, condition, seconds: float, what: str) -> None:
        """Take messages until a condition holds."""
        seconds *= PATIENCE
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f'{what} within {seconds} s; {self.last_words()}'
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Take messages for some time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)

    def last_words(self) -> str:
        """Return what the nodes said last."""
        return '; '.join(f'{name}: {list(child.words)[-2:]}'
                         for name, child in self.children.items())

    def health(self, node: str) -> dict[str, str]:
        """Return the newest diagnostics of a node."""
        for message in reversed(self.messages[topics.DIAGNOSTICS.name]):
            for status in message.status:
                if status.name == f'/{self.namespace}/{node}':
                    return {'summary': status.message,
                            **{pair.key: pair.value for pair in status.values}}
        return {}

    def join(self) -> tuple[list, TransitionJoiner]:
        """Join what was collected into transitions."""
        joiner = TransitionJoiner(capacity=100_000, image_bytes=2**40)
        joined = []
        for message in self.messages[topics.IMAGE.name]:
            joined += joiner.add_image(
                to_nanoseconds(message.header.stamp), image_to_array(message))
        for message in self.messages[topics.CMD_VEL.name]:
            joined += joiner.add_twist(
                to_nanoseconds(message.header.stamp), read_command(message.twist))
        for message in self.messages[topics.STEP.name]:
            joined += joiner.add_step(
                to_nanoseconds(message.header.stamp), read_step(read_named_values(message)))
        return joined, joiner


def kill(child) -> None:
    """End a process as a crash would."""
    os.kill(child.process.pid, signal.SIGKILL)
    child.process.wait()
