# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
fault_node: stands between those who publish topics of the contract and those who subscribe.

Purpose: be the fault. Whoever publishes `NAME` is started with the remap `NAME:=NAME_upstream`;
this node subscribes to that and publishes `NAME`, byte by byte as it came, until it is told not
to.

Parameters: `topics`, names of the contract separated by commas, read at the start; and `fault`,
"TOPIC KIND SECONDS SEED", which begins one of `relay.KINDS` when it is set and ends it by itself:

    ros2 param set /fault_node fault 'image_raw flooding 3 1'
"""
from __future__ import annotations

import contextlib
import sys
import time

from faults.relay import PASS, Relay
from msgs_bridge.host_only import stay_on_this_host
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import PolledGroup
from msgs_bridge.qos import qos_profile
from msgs_bridge.topics import STALL_DEPTH, Topic, TOPICS
from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

UPSTREAM = '_upstream'
# a node that cannot relay as fast as the graph drives would be a fault of its own
IDLE_SECONDS = 0.0005
EXECUTOR_SECONDS = 0.02

BY_NAME = {topic.name: topic for topic in TOPICS}


class FaultNode(Node):
    """The relays as one node; they decide what goes through, see `relay.Relay`."""

    def __init__(self) -> None:
        """Declare the parameters and join the topics."""
        super().__init__('fault_node')
        names = self.declare_parameter('topics', ','.join(BY_NAME)).value
        self.declare_parameter('fault', '')
        self._lanes: dict[str, tuple[Relay, Publisher, Subscription]] = {}
        for name in filter(None, names.split(',')):
            topic = BY_NAME[name]
            kind = message_class(topic.type_name)
            publisher = self.create_publisher(kind, name, qos_profile(topic))
            self._lanes[name] = Relay(topic.type_name), publisher, self._subscription(topic)
        self.add_on_set_parameters_callback(self._on_set)

    def _subscription(self, topic: Topic) -> Subscription:
        return self.create_subscription(
            message_class(topic.type_name), topic.name + UPSTREAM, lambda _: None,
            qos_profile(topic, depth=None if topic.latched else STALL_DEPTH), raw=True,
            callback_group=PolledGroup())

    def _on_set(self, parameters: list) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name != 'fault' or not parameter.value:
                continue
            try:
                topic, kind, seconds, seed = parameter.value.split()
                self._lanes[topic][0].begin(kind, float(seconds), int(seed), time.monotonic())
            except (KeyError, ValueError) as error:
                return SetParametersResult(successful=False, reason=f'{error!r}')
        return SetParametersResult(successful=True)

    def relay(self) -> int:
        """Take what has come and hand on what is due; return how many messages came."""
        came = 0
        for relay, publisher, subscription in self._lanes.values():
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, True):
                    came += 1
                    self._send(publisher, relay.arrived(taken[0], time.monotonic()))
            if relay.kind != PASS:
                self._send(publisher, relay.due(time.monotonic()))
        return came

    def _send(self, publisher: Publisher, messages: list[bytes]) -> None:
        for data in messages:
            # the middleware refuses what is longer than any message of the type
            with contextlib.suppress(RCLError):
                publisher.publish(data)


def main() -> None:
    """Run the node until it is stopped."""
    stay_on_this_host()
    rclpy.init()
    node = FaultNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        turn = 0.0
        while rclpy.ok():
            if not node.relay():
                time.sleep(IDLE_SECONDS)
            if time.monotonic() - turn > EXECUTOR_SECONDS:
                executor.spin_once(timeout_sec=0)
                turn = time.monotonic()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
