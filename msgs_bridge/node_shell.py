# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What all our nodes share: parameters from a settings class, topics, health."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
import dataclasses
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from msgs_bridge import topics
from msgs_bridge.adaptive_subscription import (
    AdaptiveSubscription, OVERRIDE_ERRORS, OVERRIDES, PolledGroup,
)
from msgs_bridge.errors import MessageError, SettingsError
from msgs_bridge.matching import deaf_subscriptions, subscriptions_of, type_name_of
from msgs_bridge.message_types import message_class
from msgs_bridge.node_parameters import declare_settings
from msgs_bridge.node_process import (
    Finished, HelpWanted, run_node, STARTED, told_in_a_line,
)
from msgs_bridge.plain_text import plain
from msgs_bridge.qos import qos_profile
from msgs_bridge.settings import check_value, describe, setting
from msgs_bridge.topics import Topic
from msgs_bridge.transport.arrival import Bell
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.timer import Timer
from std_srvs.srv import SetBool

__all__ = ['Finished', 'NodeShell', 'PolledGroup', 'run_node', 'ShellSettings']

# how often subscriptions are held against the graph; seconds
GRAPH_SECONDS = 0.5
# how long the diagnostics, of which there is one a second, warn of something that happened once;
# one of them does, however late it is; seconds
WARN_SECONDS = 1.0
# how often the log does; seconds
WARN_LOG_SECONDS = 5.0
# characters of a value in the diagnostics, and of their summary
VALUE_LENGTH, SUMMARY_LENGTH = 200, 300
# misfits that are logged, each once
MOST_TOLD = 100
# how often a node that is held back looks whether somebody still holds it; seconds
HOLDER_SECONDS = 1.0


@dataclasses.dataclass(frozen=True)
class ShellSettings:
    """What can be set on every node."""

    fast_transport: bool = setting(
        True, "false: messages come by rclpy's executor alone, at the time slices that the "
        'system gives; where the middleware cannot tell of new messages that is so anyway')


class NodeShell(Node):
    """
    A node whose parameters are a settings class and whose health is on `/diagnostics`.

    Attributes:
        settings: the current values; fields that are `live` follow `ros2 param set`.
        shell: the values of `ShellSettings`.
        counts: events counted since the start, shown in the diagnostics.
        held_back: whether a learner holds this node back, see `serve_hold`.
        has_last_word: whether `close` publishes something, for which ROS has to run still when a
            signal has come.
    """

    has_last_word = False

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
            HelpWanted: the process was asked what the node is.
        """
        if STARTED.describe_only:
            if not isinstance(settings_class, type):
                settings_class = settings_class({})
            raise HelpWanted(type(self), (settings_class, ShellSettings))
        with told_in_a_line('ROS does not start'):
            super().__init__(name)
        if not isinstance(settings_class, type):
            settings_class = settings_class(
                {key: given.value for key, given in self._parameter_overrides.items()})
        # what our timers guard is wall time, and a simulator must not wait for its own clock
        self._wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.counts: Counter[str] = Counter()
        self.held_back = False
        self._heard: list[tuple[str, AdaptiveSubscription]] = []
        self._topic_publishers: list[tuple[Topic, Publisher]] = []
        self._eager: list[AdaptiveSubscription] = []
        self._bell: Bell | None = None
        self._warnings: dict[str, tuple[str, float]] = {}
        self._untold: set[str] = set()
        self._log_again: dict[str, float] = {}
        self._told: set[str] = set()
        self._settings_class = settings_class
        self.settings, self.shell = declare_settings(
            self, (settings_class, ShellSettings), STARTED.arguments)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._diagnostics = self.publisher(topics.DIAGNOSTICS)
        self.create_timer(1.0, self.publish_diagnostics)
        self.create_timer(GRAPH_SECONDS, self._watch_graph)

    def create_timer(
        self, seconds: float, callback: Callable[[], None], *arguments: Any,
        clock: Clock | None = None, **options: Any,
    ) -> Timer:
        """Create a timer by wall time, whatever `use_sim_time` says, unless a clock is given."""
        return super().create_timer(
            seconds, callback, *arguments, clock=clock or self._wall_clock, **options)

    def publisher(self, topic: Topic, *, type_name: str | None = None) -> Publisher:
        """
        Create the publisher of a topic of the contract.

        Raises:
            SettingsError: a parameter `qos_overrides` with a value that there is not.
        """
        try:
            publisher = self.create_publisher(
                message_class(type_name or topic.type_name), topic.name, qos_profile(topic),
                qos_overriding_options=OVERRIDES)
        except OVERRIDE_ERRORS as error:
            raise SettingsError(f'qos_overrides of {topic.name}: {plain(error)}') from None
        self._topic_publishers.append((topic, publisher))
        return publisher

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Destroy a publisher, which is no longer held against the graph."""
        self._topic_publishers = [
            one for one in self._topic_publishers if one[1] is not publisher]
        return super().destroy_publisher(publisher)

    def subscription(
        self, topic: Topic, callback: Callable[[Any], None], *, type_name: str | None = None,
        depth: int | None = None, polled: bool = False, eager: bool = False,
        newest: bool = False,
    ) -> AdaptiveSubscription:
        """
        Subscribe to a topic of the contract; bad messages are counted, not fatal.

        A `MessageError` that the callback raises is logged (throttled) and the node goes on.

        Args:
            topic: of the contract.
            callback: called with a message.
            type_name: another type than the contract's.
            depth: another depth than the contract's.
            polled: nothing is called until somebody calls `take`.
            eager: messages do not wait for the executor, for nodes that another one waits for.
            newest: only the newest message that waits is wanted; others are counted as skipped.

        Raises:
            SettingsError: a parameter `qos_overrides` with a value that there is not.
        """
        def checked(message: Any) -> None:
            try:
                callback(message)
            except MessageError as error:
                self.counts[f'rejected_{topic.name}'] += 1
                self.warn_of(topic.name, str(error))

        if eager and self.shell.fast_transport and self._bell is None:
            self._bell = Bell()
        subscription = AdaptiveSubscription(
            self, message_class(type_name or topic.type_name), topic.name, checked,
            qos_profile(topic, depth=depth), newest=newest,
            group=PolledGroup() if polled else None, bell=self._bell if eager else None)
        self._heard.append((topic.name, subscription))
        if subscription.rings:
            self._eager.append(subscription)
        return subscription

    def unsubscribe(self, subscription: AdaptiveSubscription) -> None:
        """Hear nothing more of a subscription that is not eager."""
        self._heard = [one for one in self._heard if one[1] is not subscription]
        subscription.destroy()

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

    def take(self, subscription: AdaptiveSubscription) -> bool:
        """Take one message of a polled subscription, if there is one, and call its callback."""
        return subscription.take()

    def take_eagerly(self, seconds: float) -> None:
        """Call the callbacks of eager subscriptions as messages come, for some seconds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            # all are looked at, whichever has a message
            if not any([subscription.take() for subscription in self._eager]):
                self._bell.wait(until)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return level, summary and values for the diagnostics; nodes add theirs."""
        return DiagnosticStatus.OK, 'running', {}

    def parts_health(self) -> Iterable[tuple[str, bytes, str, dict[str, object]]]:
        """Return name, level, summary and values of parts that have a health of their own."""
        return ()

    def warn_of(self, what: str, text: str) -> None:
        """Log (throttled) what has happened to something, and warn of it for a while."""
        now = time.monotonic()
        # it may quote what came from outside
        text = plain(text, VALUE_LENGTH)
        self._warnings[what] = text, now + WARN_SECONDS
        self._untold.add(what)
        # rclpy's own throttle takes 0.6 ms to say nothing, which is too long for a flood
        if now >= self._log_again.get(what, 0.0):
            self._log_again[what] = now + WARN_LOG_SECONDS
            self.get_logger().warn(f'{what}: {text}')

    def refused_lately(self, topic: Topic) -> bool:
        """Return whether a message of a topic was refused within the last seconds."""
        _, until = self._warnings.get(topic.name, ('', 0.0))
        return until > time.monotonic()

    def publish_diagnostics(self) -> None:
        """Publish the health of this node, what does not fit in the graph and what was counted."""
        level, summary, values = self.health()
        now = time.monotonic()
        # of copies, for other threads may warn meanwhile
        untold = self._untold.copy()
        troubles = [*self._misfits(), *(
            f'{what}: {text}' for what, (text, until) in list(self._warnings.items())
            if until > now or what in untold)]
        self._untold -= untold
        if troubles:
            level = max(level, DiagnosticStatus.WARN)
            summary = '; '.join([summary, *troubles])
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(),
            message=plain(summary, SUMMARY_LENGTH), hardware_id='carracing_dqn')
        counted = {
            f'{what}_{topic}': count
            for topic, subscription in self._heard
            for what, count in subscription.counts.items()}
        status.values = _key_values({**values, **self.counts, **counted})
        message.status = [status, *(
            DiagnosticStatus(
                level=level, name=f'{status.name}: {part}', message=plain(text, SUMMARY_LENGTH),
                hardware_id=status.hardware_id, values=_key_values(figures))
            for part, level, text, figures in self.parts_health())]
        self._diagnostics.publish(message)

    def settings_changed(self) -> None:
        """Take over live settings after `self.settings` has changed; nodes override it."""

    def close(self) -> None:
        """Save or finish what must not be lost; called once on every way out."""

    def _watch_graph(self) -> None:
        for _, subscription in self._heard:
            subscription.watch()

    def _misfits(self) -> list[str]:
        """Return a text for every end of a topic that does not fit ours; log what is new."""
        found = [f'{topic}: {text}'
                 for topic, subscription in self._heard
                 for text in subscription.unheard]
        for topic, publisher in self._topic_publishers:
            type_name = type_name_of(publisher.msg_type)
            found += [f'{topic.name}: {text}' for text in deaf_subscriptions(
                subscriptions_of(self, publisher.topic_name), type_name, publisher.qos_profile)]
        for text in found:
            # bounded, for names come from outside
            if text not in self._told and len(self._told) < MOST_TOLD:
                self._told.add(text)
                self.get_logger().warn(text)
        return found

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
            try:
                # they may not go together
                self.settings = dataclasses.replace(self.settings, **changes)
            except SettingsError as error:
                return SetParametersResult(successful=False, reason=str(error))
            self.settings_changed()
        return SetParametersResult(successful=True)


def _key_values(values: Mapping[str, object]) -> list[KeyValue]:
    return [KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float)
                     else plain(value, VALUE_LENGTH)) for key, value in values.items()]
