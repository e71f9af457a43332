# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A node of ours and one of somebody else's in one process, joined by real DDS."""
import itertools
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from msgs_bridge.node_shell import NodeShell
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

_numbers = itertools.count()


class Pair:
    """Both nodes, in a namespace that no other test has."""

    def __init__(self) -> None:
        """Name the namespace; nothing runs yet."""
        self.space = f'/pair{next(_numbers)}'
        self.statuses: list[DiagnosticStatus] = []

    def start(self, make_node, *arguments: str) -> NodeShell:
        """Start both, ours with arguments for ROS, and return ours."""
        rclpy.init(args=['--ros-args', '-r', f'__ns:={self.space}', *arguments],
                   signal_handler_options=SignalHandlerOptions.NO)
        # DDS refuses two types of one topic within a participant
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.other = rclpy.create_node(
            'other', context=self.context, namespace=self.space, use_global_arguments=False,
            start_parameter_services=False)
        self.executors = (
            SingleThreadedExecutor(), SingleThreadedExecutor(context=self.context))
        self.other.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.executors[1].add_node(self.other)
        self.shell = make_node()
        self.executors[0].add_node(self.shell)
        return self.shell

    def stop(self) -> None:
        """End both."""
        rclpy.try_shutdown()
        rclpy.try_shutdown(context=self.context)

    def offer(self, kind: type, topic: str, *, depth: int = 10, **qos: object):
        """Publish as somebody else would."""
        return self.other.create_publisher(kind, topic, QoSProfile(depth=depth, **qos))

    def spin_until(self, condition, seconds: float, what: str, work=lambda: None) -> None:
        """Work and take messages until a condition holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f'{what} within {seconds} s; {self.status}'
            work()
            for executor in self.executors:
                executor.spin_once(timeout_sec=0.005)

    @property
    def status(self) -> DiagnosticStatus | None:
        """Return the newest diagnostics of ours."""
        return self.statuses[-1] if self.statuses else None

    def value(self, key: str) -> str | None:
        """Return a value of the newest diagnostics of ours."""
        values = {pair.key: pair.value for pair in self.status.values} if self.status else {}
        return values.get(key)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses += [one for one in message.status if one.name.startswith(self.space)]
