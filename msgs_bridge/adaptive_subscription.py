# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A subscription that goes on hearing: it is made anew when what it asks for no longer fits.

Two things change while a node runs: a publisher comes that offers less than is asked for (best
effort, volatile), and a history of thousands of messages is gigabytes where they are large.
"""
from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Sequence
import copy
import time
from typing import Any

from msgs_bridge.errors import SettingsError
from msgs_bridge.matching import (
    common_request, publishers_of, type_name_of, unheard_publishers,
)
from msgs_bridge.plain_text import plain
from msgs_bridge.transport.arrival import Bell
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    EventHandler, QoSSubscriptionEventType, SubscriptionEventCallbacks, UnsupportedEventTypeError,
)
from rclpy.exceptions import (
    InvalidHandle, InvalidParameterTypeException, ParameterException,
)
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

# what may be set as `qos_overrides./topic.subscription.POLICY`
OVERRIDES = QoSOverridingOptions([
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY])
# what rclpy raises for a value that an override cannot have
OVERRIDE_ERRORS = (InvalidQosOverridesError, ParameterException, InvalidParameterTypeException,
                   RuntimeError, ValueError, AttributeError, TypeError)
# what may wait in the middleware; 2,000 images of 96x96 are 55 MB
QUEUE_BYTES = 64 << 20
LEAST_DEPTH = 2
# a subscription is not made anew more often because of sizes, which anybody may choose
RESIZE_SECONDS = 2.0


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


class AdaptiveSubscription:
    """
    One subscription of a node, whatever becomes of the object in the middleware.

    Attributes:
        name: the topic as it is known in the graph, remapped.
        counts: `skipped`, and `lost` by the middleware.
        publishers: how many there are, of whatever type.
        unheard: a text for each publisher from which nothing comes, and why.
        qos: what is asked for now.
    """

    def __init__(
        self, node: Node, message_class: type, topic: str, callback: Callable[[Any], None],
        qos: QoSProfile, *, group: CallbackGroup | None = None, newest: bool = False,
        bell: Bell | None = None,
    ) -> None:
        """
        Subscribe.

        Args:
            node: whose subscription it is.
            message_class: of its messages.
            topic: its name, before remapping.
            callback: called with a message.
            qos: what to ask for; parameters `qos_overrides` change it, as in rclpy.
            group: keeps it out of the executor, for those who `take`.
            newest: whether only the newest message that waits is wanted.
            bell: to be rung when a message has come, which keeps it out of the executor, too.

        Raises:
            SettingsError: an override with a value that there is not.
        """
        self.name = node.resolve_topic_name(topic)
        self.counts: Counter[str] = Counter()
        self.publishers = 0
        self.unheard: list[str] = []
        self.qos = qos
        self._node, self._topic = node, topic
        self._message_class, self._type_name = message_class, type_name_of(message_class)
        self._deliver = callback
        self._group, self._newest, self._bell = group, newest, bell
        self._resized_at = time.monotonic()
        self._largest = 0
        set_by_user = {
            kind for kind in OVERRIDES.policy_kinds
            if f'qos_overrides.{self.name}.subscription.{kind.name.lower()}'
            in node._parameter_overrides}
        self._matches = not set_by_user & {QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY}
        self._resizes = not set_by_user & {QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH}
        try:
            # the profile itself is changed by the parameters
            self.subscription = self._make(overrides=OVERRIDES)
        except OVERRIDE_ERRORS as error:
            raise SettingsError(f'qos_overrides.{self.name}: {plain(error)}') from None
        self._latched = self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._depth = self.qos.depth

    @property
    def rings(self) -> bool:
        """Return whether a bell rings for messages; otherwise the executor delivers them."""
        return self._bell is not None

    @property
    def matched(self) -> int:
        """Return how many publishers it hears: those that fit, and that have been found."""
        try:
            return self.subscription.get_publisher_count()
        except InvalidHandle:
            # another thread is making it anew
            return 0

    def take(self) -> bool:
        """Take one message, if there is one, and call the callback; for polled ones."""
        message = self._take_one()
        if message is None:
            return False
        self._receive(message)
        return True

    def destroy(self) -> None:
        """Hear nothing more; who takes meanwhile in another thread gets nothing."""
        self._destroy(self.subscription)

    def watch(self) -> None:
        """Look at the graph and be made anew if need be; to be called twice a second or so."""
        self._count_losses()
        publishers = publishers_of(self._node, self.name)
        self.publishers = len(publishers)
        if publishers:
            self._fit(publishers)
        self.unheard = unheard_publishers(publishers, self._type_name, self.qos)
        if self._resizes:
            self._fit_sizes()

    def _receive(self, message: Any) -> None:
        """Deliver a message, or the newest one that waits behind it."""
        if self._newest:
            # bounded, for messages may come faster than they are taken
            for _ in range(self._depth):
                newer = self._take_one()
                if newer is None:
                    break
                message = newer
                self.counts['skipped'] += 1
        data = getattr(message, 'data', None)
        if type(data) is array and len(data) > self._largest:
            self._largest = len(data) * data.itemsize
        self._deliver(message)

    def _take_one(self) -> Any | None:
        handle = self.subscription.handle
        try:
            with handle:
                taken = handle.take_message(self._message_class, False)
        except InvalidHandle:
            # another thread is making it anew
            return None
        return None if taken is None else taken[0]

    def _fit(self, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Ask for what all publishers of the type offer, and for no less."""
        ours = [one for one in publishers if one.topic_type == self._type_name]
        if not self._matches or not ours:
            return
        wanted = common_request(ours, latched=self._latched)
        if wanted != (self.qos.reliability, self.qos.durability):
            self.qos.reliability, self.qos.durability = wanted
            self._node.get_logger().info(
                f'{self.name}: asking for {wanted[0].name.lower().replace("_", " ")}, '
                f'{wanted[1].name.lower().replace("_", " ")} now, as its publishers offer')
            self._make_anew()

    def _fit_sizes(self) -> None:
        """Keep what may wait in the middleware below `QUEUE_BYTES`."""
        largest, self._largest = self._largest, 0
        now = time.monotonic()
        if largest and now - self._resized_at > RESIZE_SECONDS:
            depth = min(self._depth, max(LEAST_DEPTH, QUEUE_BYTES // largest))
            if depth != self.qos.depth:
                self.qos.depth = depth
                self._resized_at = now
                self._make_anew()

    def _make_anew(self) -> None:
        # DDS refuses a second reader of the topic with another type support, so the old one first
        self._destroy(self.subscription)
        self.subscription = self._make()

    def _make(self, overrides: QoSOverridingOptions | None = None) -> Subscription:
        qos = self.qos if overrides is not None else copy.copy(self.qos)
        subscription = self._node.create_subscription(
            self._message_class, self._topic, self._receive, qos,
            callback_group=PolledGroup() if self.rings else self._group,
            qos_overriding_options=overrides,
            # what does not match is found by `watch`, for polled ones as well
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        # asked by `watch`; in the executor's wait set it would wake the executor at every message
        try:
            self._losses = EventHandler(
                callback_group=PolledGroup(), callback=None, parent_impl=subscription.handle,
                event_type=QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST)
        except UnsupportedEventTypeError:
            self._losses = None
        if self.rings and not self._bell.ring_for(subscription):
            # this middleware does not tell of new messages
            self._bell = None
            self._destroy(subscription)
            return self._make()
        return subscription

    def _destroy(self, subscription: Subscription) -> None:
        if self._losses is not None:
            self._losses.destroy()
            self._losses = None
        self._node.destroy_subscription(subscription)

    def _count_losses(self) -> None:
        if self._losses is None:
            return
        self._losses._ready_to_take_data = True
        lost = self._losses.take_data()
        if lost is not None:
            self.counts['lost'] += lost.total_count_change
