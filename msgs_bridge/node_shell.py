# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What all our nodes share: parameters from a settings class, topics, health, clean shutdown."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import dataclasses
import gc
import os
import signal
import sys
import time
import traceback
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from msgs_bridge import topics
from msgs_bridge.transport.arrival import Bell
from msgs_bridge.errors import BridgeError, MessageError, SettingsError
from msgs_bridge.message_types import message_class
from msgs_bridge.host_only import stay_on_this_host
from msgs_bridge.qos import qos_profile
from msgs_bridge.settings import check_value, describe, from_mapping
from msgs_bridge.transport.time_slices import shorten_time_slices
from msgs_bridge.topics import Topic
from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult,
)
import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import get_default_context
from std_srvs.srv import SetBool

# declared by rclpy itself, or by it on our behalf
FOREIGN_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')

# How often the executor has its turn in a node with eager subscriptions. One turn takes 0.3 to
# 0.5 ms in rclpy, which is as long as the car needs for four frames.
EXECUTOR_SECONDS = 0.01

# how often a node that is held back looks whether somebody still holds it; seconds
HOLDER_SECONDS = 1.0


class Finished(Exception):
    """Raised in a callback by a node whose work is done; the process ends with code 0."""


class PolledGroup(CallbackGroup):
    """Keeps its subscriptions out of the executor, for a thread that takes messages itself."""

    def can_execute(self, entity: object) -> bool:
        """Tell the executor to leave them alone."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Tell the executor to leave them alone."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Do nothing: nothing has begun."""


class NodeShell(Node):
    """
    A node whose parameters are a settings class and whose health is on `/diagnostics`.

    Attributes:
        settings: the current values; fields that are `live` follow `ros2 param set`.
        counts: events counted since the start, shown in the diagnostics.
        held_back: whether a learner holds this node back, see `serve_hold`.
    """

    def __init__(
        self, name: str, settings_class: type | Callable[[dict[str, object]], type],
    ) -> None:
        """
        Declare the parameters and start the 1 Hz diagnostics.

        Args:
            name: of the node.
            settings_class: its settings, or what finds them by the parameters that were given.

        Raises:
            SettingsError: a parameter that is unknown or not accepted.
        """
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        super().__init__(name)
        if not isinstance(settings_class, type):
            settings_class = settings_class(
                {key: given.value for key, given in self._parameter_overrides.items()})
        self.counts: Counter[str] = Counter()
        self.held_back = False
        self._eager: list[Any] = []
        self._bell = Bell()
        self._settings_class = settings_class
        self.settings = from_mapping(settings_class, self._declare(settings_class))
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._diagnostics = self.publisher(topics.DIAGNOSTICS)
        self.create_timer(1.0, self.publish_diagnostics)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], None],
        callback_group: CallbackGroup | None = None, clock: Clock | None = None, **options: Any,
    ) -> Any:
        """Create a timer that runs by wall time, unless a clock is given: /clock may stand."""
        return super().create_timer(
            timer_period_sec, callback, callback_group, clock or self._wall, **options)

    def publisher(self, topic: Topic, *, type_name: str | None = None) -> Any:
        """Create the publisher of a topic of the contract."""
        return self.create_publisher(
            message_class(type_name or topic.type_name), topic.name, qos_profile(topic))

    def subscription(
        self, topic: Topic, callback: Callable, *, type_name: str | None = None,
        depth: int | None = None, polled: bool = False, eager: bool = False,
    ) -> Any:
        """
        Subscribe to a topic of the contract; bad messages are counted, not fatal.

        A `MessageError` that the callback raises is logged (throttled) and the node goes on.
        With `polled` nothing is called until somebody calls `take`; with `eager` they do
        not wait for the executor, for those that another node waits for.
        """
        def checked(message: Any) -> None:
            try:
                callback(message)
            except MessageError as error:
                self.counts[f'rejected_{topic.name}'] += 1
                self.get_logger().warn(
                    f'{topic.name}: {error}', throttle_duration_sec=5.0)

        subscription = self.create_subscription(
            message_class(type_name or topic.type_name), topic.name, checked,
            qos_profile(topic, depth=depth),
            callback_group=PolledGroup() if polled or eager else None)
        if eager:
            self._eager.append(subscription)
            self._bell.ring_for(subscription)
        return subscription

    @property
    def eager(self) -> bool:
        """Return whether the node has eager subscriptions."""
        return bool(self._eager)

    def serve_hold(self, changed: Callable[[], None]) -> None:
        """
        Offer `~/hold` (std_srvs/SetBool), by which a slow learner holds this node back.

        It is apart from `~/pause`, so that a learner that has caught up does not end a person's
        pause, and it ends with its last client, so that a dead learner does not hold on for ever.

        Args:
            changed: called after `held_back` has changed.
        """
        name = self.resolve_service_name('~/hold')

        def hold(held: bool) -> None:
            self.held_back = held
            changed()

        def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
            hold(request.data)
            response.success = True
            response.message = 'held back' if request.data else 'not held back'
            return response

        def outlive_holder() -> None:
            if self.held_back and not self.count_clients(name):
                self.get_logger().warn('who held this node back is gone: going on')
                hold(False)

        self.create_service(SetBool, name, answer)
        self.create_timer(HOLDER_SECONDS, outlive_holder)

    def take(self, subscription: Any) -> bool:
        """Take one message of a polled subscription, if there is one, and call its callback."""
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return False
        subscription.callback(taken[0])
        return True

    def take_eagerly(self, seconds: float) -> None:
        """Call the callbacks of eager subscriptions as messages come, for some seconds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            # all are looked at, whichever has a message
            if not any([self.take(subscription) for subscription in self._eager]):
                self._bell.wait(until)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return level, summary and values for the diagnostics; nodes add theirs."""
        return DiagnosticStatus.OK, 'running', {}

    def publish_diagnostics(self) -> None:
        """Publish the health of this node."""
        level, summary, values = self.health()
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), message=summary,
            hardware_id='carracing_dqn')
        status.values = [
            KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))
            for key, value in {**values, **self.counts}.items()]
        message.status = [status]
        self._diagnostics.publish(message)

    def settings_changed(self) -> None:
        """Take over live settings after `self.settings` has changed; nodes override it."""

    def close(self) -> None:
        """Save or finish what must not be lost; called once on every way out."""

    def _declare(self, settings_class: type) -> dict[str, object]:
        known = describe(settings_class)
        overrides = self._parameter_overrides
        for name in overrides:
            if name not in known and not name.startswith(FOREIGN_PARAMETERS):
                from_mapping(settings_class, {name: None})
        values = {}
        for name, (kind, default, description) in known.items():
            given = overrides.get(name)
            if given is not None and kind is float and given.type_ == Parameter.Type.INTEGER:
                overrides[name] = Parameter(name, value=float(given.value))
            elif given is not None:
                check_value(name, kind, description, given.value)
            descriptor = ParameterDescriptor(
                description=description.text, additional_constraints=description.accepted,
                read_only=not description.live)
            if description.low is not None:
                limits = {'from_value': kind(description.low), 'to_value': kind(description.high)}
                if kind is int:
                    descriptor.integer_range = [IntegerRange(**limits)]
                else:
                    descriptor.floating_point_range = [FloatingPointRange(**limits)]
            try:
                values[name] = self.declare_parameter(name, default, descriptor).value
            except (ParameterException, InvalidParameterTypeException) as error:
                raise SettingsError(f'{name}: {error}') from None
        return values

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        known = describe(self._settings_class)
        changes = {}
        for parameter in parameters:
            if parameter.name in known:
                kind, _, description = known[parameter.name]
                try:
                    changes[parameter.name] = check_value(
                        parameter.name, kind, description, parameter.value)
                except SettingsError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        if changes:
            self.settings = dataclasses.replace(self.settings, **changes)
            self.settings_changed()
        return SetParametersResult(successful=True)


def run_node(make_node: Callable[[], NodeShell], args: list[str] | None = None) -> int:
    """
    Run one node until SIGINT, SIGTERM or shutdown, and end the process.

    A `BridgeError` while starting or running ends it with one line and code 2, an unexpected
    error with its traceback and code 1, anything else with code 0.
    """
    code = 0
    try:
        stay_on_this_host()
        _spin_to_the_end(make_node, args)
    except BridgeError as error:
        sys.stderr.write(f'error: {error}\n')
        code = 2
    except Exception:  # the process ends here, so this is where it is told
        traceback.print_exc()
        code = 1
    _leave(code)
    return code


def _spin_to_the_end(make_node: Callable[[], NodeShell], args: list[str] | None) -> None:
    rclpy.init(args=args)
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if node.eager:
            shorten_time_slices()
            while rclpy.ok():
                executor.spin_once(timeout_sec=0)
                node.take_eagerly(EXECUTOR_SECONDS)
        else:
            executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException, Finished):
        pass
    except Exception:
        # a signal in the middle of a callback makes any call of rclpy fail
        if rclpy.ok():
            raise
    finally:
        # what is left to do is bounded, and a second Ctrl-C must not cut off a save
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def _leave(code: int) -> None:
    """
    End the process without unloading every library.

    Everything is saved and destroyed by now; taking down torch and DDS at the end of the
    interpreter was seen to take 2 of the 3 seconds in which a run has to stop.
    """
    get_default_context(shutting_down=True)
    # the context goes with its last reference, and the DDS participant with it
    gc.collect()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
