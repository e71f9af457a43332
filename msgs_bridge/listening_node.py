# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A small node beside the graph, in a thread of its own: it looks on, and nothing ends it."""
from __future__ import annotations

import threading

from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.errors import BridgeError
from msgs_bridge.node_process import told_in_a_line
from msgs_bridge.plain_text import plain
import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace

# how long a turn waits for a message; seconds
TURN_SECONDS = 0.5
# after a turn that failed, so that one that fails again and again does not spin
FAILED_SECONDS = 0.05
# characters of a namespace: DDS has 255 for a name, in which nodes and their services follow
LONGEST = 180


def node_of_a_command(name: str, namespace: str = '') -> tuple[Node, SingleThreadedExecutor]:
    """
    Return a node without services of its own and its executor; signals stay with the caller.

    It belongs to a context of its own, which the caller shuts down.

    Raises:
        BridgeError: the machine lacks what every node needs, or there is no such namespace.
    """
    before_rclpy()
    context = Context()
    with told_in_a_line('ROS does not start'):
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with told_in_a_line('ROS does not start'):
            node = rclpy.create_node(
                name, context=context, namespace=namespace or None,
                start_parameter_services=False, enable_rosout=False, use_global_arguments=False)
    except BaseException:
        rclpy.try_shutdown(context=context)
        raise
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    return node, executor


class ListeningNode:
    """
    A node of a command; signals stay with the caller.

    Attributes:
        failed: turns that ended with an exception, of whatever kind.
    """

    def __init__(self, name: str, namespace: str = '') -> None:
        """
        Join the graph; nothing is heard before `start`.

        Raises:
            BridgeError: the machine lacks what every node needs.
        """
        self.failed = 0
        self._node, self._executor = node_of_a_command(name, namespace)
        self._context = self._node.context
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._closing.set()
        self._executor.shutdown(timeout_sec=0.5)
        if self._thread.is_alive():
            self._thread.join(timeout=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def turn(self) -> None:
        """Take what comes within a moment; whatever it raises is counted, and the next follows."""
        self._executor.spin_once(timeout_sec=TURN_SECONDS)

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                self.turn()
            except ExternalShutdownException:
                return
            except Exception:
                # the middleware refuses some messages by exceptions of its own, of any kind
                self.failed += 1
                self._closing.wait(FAILED_SECONDS)


def absolute_namespace(text: str) -> str:
    """
    Return a namespace as nodes have it in their full names, '' for the root.

    Raises:
        BridgeError: it is none that ROS accepts.
    """
    namespace = f'/{text.strip("/")}'
    if len(namespace) > LONGEST:
        raise BridgeError(f'--namespace is {plain(text)!r}: {len(namespace)} characters; '
                          f'accepted: up to {LONGEST}')
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException as error:
        reason = str(error).splitlines()[0].rstrip(':').lower()
        raise BridgeError(
            f'--namespace is {plain(text)!r}: {reason}; accepted: names of letters, digits '
            'and underscores, joined by /') from None
    return namespace.rstrip('/')
