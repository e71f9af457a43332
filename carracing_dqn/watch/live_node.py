# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The live graph as a source of what is watched: a node that looks on.

It must not be noticed by who drives: its subscriptions are best effort, raw, of small depth and
polled, and none is made while somebody waits for subscriptions, which it would be counted as.
"""
from __future__ import annotations

import dataclasses
import itertools
import queue
import time
from typing import Any, NamedTuple

from carracing_dqn.watch.car import IMAGE_TYPES, TWIST_TYPES
from carracing_dqn.watch.commands import calls, COMMANDS
from carracing_dqn.watch.graph_parts import End, Misfit, TopicEnds
from carracing_dqn.watch.state import cars_first, MAX_TOPICS, WatchState
from dqn_policy_node.settings import PolicySettings
from msgs_bridge import matching
from msgs_bridge.adaptive_subscription import PolledGroup
from msgs_bridge.errors import MessageError
from msgs_bridge.listening_node import ListeningNode
from msgs_bridge.message_types import message_class
from msgs_bridge.plain_text import plain
from msgs_bridge.topics import CMD_VEL, DIAGNOSTICS, IMAGE_ANNOTATED, TOPICS
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import SetBool, Trigger

NAME = 'carracing_watch'
# seconds from one look at the messages to the next, and from one look at the graph
LOOK_SECONDS, GRAPH_SECONDS = 0.25, 1.0
POLL_SECONDS = 0.1
PARAMETER_SECONDS = 5.0
# a node that says nothing of itself is left alone so long, one that never was well longer
QUIET_SECONDS, UNWELL_SECONDS = 4.0, 12.0
# messages that wait in the middleware: two images, to see how the picture moves
IMAGE_DEPTH, DEPTH, LATCHED_DEPTH, HEALTH_DEPTH = 2, 50, 20, 100
MAX_SUBSCRIPTIONS = 60
# a topic that could not be heard is tried again: the machine may have lacked something
REFUSED_SECONDS = 30.0
# of the graph itself, and of no use to who looks at a car
LEFT_OUT = ('/rosout', '/parameter_events')
LATCHED = frozenset(topic.name for topic in TOPICS if topic.latched and topic.depth > 1)
SIMULATOR_PARAMETERS = ('wait_for_subscribers', 'stepping', 'action_repeat', 'real_time_factor')
POLICY_PARAMETERS = tuple(field.name for field in dataclasses.fields(PolicySettings))
# a node that starts, or a busy machine, takes its time
ANSWER_SECONDS = 10.0


class Ear(NamedTuple):
    """A subscription of the watch and the type of its messages."""

    subscription: Subscription
    type_name: str


class LiveSource(ListeningNode):
    """
    Fills a `WatchState` from the graph and carries out commands.

    Attributes:
        state: what is known.
        commands: names of what can be done.
    """

    commands = COMMANDS

    def __init__(self, namespace: str = '', *, domain: str = '') -> None:
        """
        Join the graph and look on.

        Args:
            namespace: of the node itself; every namespace is watched.
            domain: ROS_DOMAIN_ID, to be shown.

        Raises:
            BridgeError: the machine lacks what every node needs.
        """
        super().__init__(NAME, namespace)
        self.state = WatchState(f'live, domain {domain or "0"}')
        self._full_name = self._node.get_fully_qualified_name()
        self._ears: dict[str, Ear] = {}
        self._group = PolledGroup()
        # until when
        self._refused: dict[tuple[str, str], float] = {}
        self._asked: queue.SimpleQueue[tuple[str, Any, str | None]] = queue.SimpleQueue()
        self._pending: list[tuple[str, Any, float]] = []
        self._clients: dict[tuple[str, type], Any] = {}
        self._look_at = self._graph_at = self._parameters_at = 0.0
        self.start()

    @staticmethod
    def now() -> float:
        """Return the time by which ages are counted; seconds."""
        return time.monotonic()

    def act(self, name: str, value: Any = None, namespace: str | None = None) -> None:
        """
        Do something by name; the answer comes in `state.notice`.

        Raises:
            BridgeError: there is no such command, or the value is none for it.
        """
        COMMANDS.check(name, value)
        self._asked.put((name, value, namespace))

    def turn(self) -> None:
        """Take what has come, and look at the graph now and then."""
        self._executor.spin_once(timeout_sec=POLL_SECONDS)
        now = self.now()
        if now >= self._graph_at:
            # one look that fails is not made again at once, so that messages are taken meanwhile
            self._graph_at = now + GRAPH_SECONDS
            self._look_at_graph(now)
            # of a graph of hundreds of topics it takes a while, and not more than a tenth of it
            after = self.now()
            self._graph_at = after + max(GRAPH_SECONDS, 9 * (after - now))
        self._poll(now)
        if now >= self._look_at:
            self._look_at = now + LOOK_SECONDS
            self.state.look(now)
        while not self._asked.empty():
            self._do(*self._asked.get())
        self._take_answers(now)

    # --- the graph

    def _look_at_graph(self, now: float) -> None:
        node = self._node
        nodes = {f'{space.rstrip("/")}/{name}'
                 for name, space in matching.nodes_of(node)
                 if not name.startswith('_')} - {self._full_name}
        names = matching.as_known(matching.topics_of, node)
        services = set(matching.as_known(matching.services_of, node))
        found: dict[str, tuple[TopicEnds, list[TopicEndpointInfo]]] = {}
        shown = cars_first({name: types for name, types in names.items()
                            if name not in LEFT_OUT and not any(
                                part.startswith('_') for part in name.split('/'))})
        for name in shown[:MAX_TOPICS]:
            publishers, subscriptions = (
                [end for end in find(node, name) if matching.full_name(end) != self._full_name]
                for find in (matching.publishers_of, matching.subscriptions_of))
            if publishers or subscriptions:
                found[name] = _ends(publishers, subscriptions), publishers
        self.state.see_graph(
            map(plain, nodes), {name: ends for name, (ends, _) in found.items()}, now, services)
        # it is painted only if somebody takes it
        heard = [name for name, (_, publishers) in found.items()
                 if publishers and name.rpartition('/')[2] != IMAGE_ANNOTATED.name]
        del heard[MAX_SUBSCRIPTIONS:]
        for name in list(self._ears):
            if name not in heard or self._ears[name].type_name != found[name][0].type_name:
                self._node.destroy_subscription(self._ears.pop(name).subscription)
        self._refused = {key: until for key, until in self._refused.items() if now < until}
        for name in heard:
            self._follow(name, *found[name], now)
        if now >= self._parameters_at:
            self._parameters_at = now + PARAMETER_SECONDS
            self._ask_parameters(services)
        for key in [key for key in self._clients if key[0] not in services]:
            node.destroy_client(self._clients.pop(key))

    def _follow(
        self, name: str, ends: TopicEnds, publishers: list[TopicEndpointInfo], now: float,
    ) -> None:
        """Subscribe to a topic if that is not noticed; what cannot be heard is left a while."""
        if name in self._ears or (name, ends.type_name) in self._refused:
            return
        if not all(self._may_listen_to(end.node, now) for end in ends.publishers) and (
                ends.type_name != DIAGNOSTICS.type_name):
            return
        if name.rpartition('/')[2] == CMD_VEL.name and ends.type_name in TWIST_TYPES and (
                not ends.subscriptions):
            # who sends them says that nobody hears them
            return
        try:
            self._ears[name] = self._listen(name, ends.type_name, publishers)
        except Exception as error:
            # of what the wire names anything may be wrong, and rcl and DDS raise as they like
            self._refused[name, ends.type_name] = now + REFUSED_SECONDS
            if isinstance(error, MessageError):
                self.state.say(f'{name} is not heard: {error}')

    def _may_listen_to(self, name: str, now: float) -> bool:
        """Return whether a node no longer counts subscriptions before it begins."""
        node = self.state.nodes.get(name)
        if node is None:
            return False
        if node.heard_at is None:
            return now - node.since > QUIET_SECONDS
        if node.was_ok:
            return True
        return now - node.since > UNWELL_SECONDS and 'subscription' not in node.summary

    def _listen(self, name: str, type_name: str, publishers: list[TopicEndpointInfo]) -> Ear:
        latched = name.rpartition('/')[2] in LATCHED
        qos = QoSProfile(
            depth=LATCHED_DEPTH if latched else HEALTH_DEPTH
            if type_name == DIAGNOSTICS.type_name else IMAGE_DEPTH
            if type_name in IMAGE_TYPES else DEPTH,
            reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
        if latched or type_name == DIAGNOSTICS.type_name:
            # rare, and none of them may be missed
            qos.reliability, qos.durability = matching.common_request(
                [end for end in publishers if end.topic_type == type_name], latched=latched)
        subscription = self._node.create_subscription(
            message_class(type_name), name, _unused, qos, raw=True, callback_group=self._group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        return Ear(subscription, type_name)

    # --- messages

    def _poll(self, now: float) -> None:
        for name, ear in list(self._ears.items()):
            try:
                handle = ear.subscription.handle
                with handle:
                    for _ in range(HEALTH_DEPTH):
                        taken = handle.take_message(ear.subscription.msg_type, True)
                        if taken is None:
                            break
                        data, info = taken
                        self.state.take(name, ear.type_name, data, now,
                                        info['publication_sequence_number'] or 0)
            except Exception:
                # one message that the middleware cannot hand over
                self.failed += 1

    # --- parameters and commands

    def _ask_parameters(self, services: set[str]) -> None:
        for end, names in (('/enable', POLICY_PARAMETERS), ('/hold', SIMULATOR_PARAMETERS)):
            for service in services:
                if service.endswith(end):
                    name = service.removesuffix(end)
                    what = f'parameters of {name}'
                    asked = any(one == what for one, _, _ in self._pending)
                    if f'{name}/get_parameters' in services and not asked:
                        self._call(what, GetParameters,
                                   f'{name}/get_parameters',
                                   GetParameters.Request(names=list(names)), names, name)

    def _do(self, name: str, value: Any, namespace: str | None) -> None:
        planned = list(calls(name, value, self.state, namespace))
        if not planned:
            self.state.say(f'{name}: nobody here offers it')
        for call in planned:
            if call.kind == 'parameter':
                request = SetParameters.Request(parameters=[
                    Parameter(call.name, value=call.value).to_parameter_msg()])
                self._call(name, SetParameters, call.service, request)
            elif call.kind == 'switch':
                self._call(name, SetBool, call.service, SetBool.Request(data=bool(call.value)))
            else:
                self._call(name, Trigger, call.service, Trigger.Request())

    def _call(
        self, what: str, kind: type, service: str, request: Any,
        names: tuple[str, ...] = (), of: str = '',
    ) -> None:
        key = service, kind
        if key not in self._clients:
            self._clients[key] = self._node.create_client(kind, service)
        future = self._clients[key].call_async(request)
        self._pending.append((what, (future, self._clients[key], names, of),
                              self.now() + ANSWER_SECONDS))

    def _take_answers(self, now: float) -> None:
        pending, self._pending = self._pending, []
        for what, (future, client, names, of), until in pending:
            if future.done():
                try:
                    self._answered(what, future.result(), names, of)
                except Exception:
                    # a parameter of a type that there is not, for one
                    self.failed += 1
            elif now < until:
                self._pending.append((what, (future, client, names, of), until))
            else:
                client.remove_pending_request(future)
                if not names:
                    self.state.say(f'{what}: no answer')

    def _answered(self, what: str, answer: Any, names: tuple[str, ...], of: str) -> None:
        if names:
            values = map(parameter_value_to_python, answer.values)
            self.state.take_parameters(plain(of), dict(itertools.islice(zip(names, values), 200)))
        elif hasattr(answer, 'results'):
            bad = [one.reason for one in answer.results if not one.successful]
            self.state.say(f'{what}: {bad[0] if bad else "done"}')
        else:
            done = 'done' if answer.success else 'refused'
            self.state.say(f'{what}: {answer.message or done}')


def _ends(
    publishers: list[TopicEndpointInfo], subscriptions: list[TopicEndpointInfo],
) -> TopicEnds:
    return TopicEnds(
        plain((publishers or subscriptions)[0].topic_type),
        [_end(one) for one in publishers[:50]], [_end(one) for one in subscriptions[:50]],
        [Misfit(one.kind, matching.full_name(one.publisher), matching.full_name(one.subscription),
                one.reason)
         for one in itertools.islice(matching.misfits(publishers[:50], subscriptions[:50]), 20)])


def _end(end: TopicEndpointInfo) -> End:
    qos = end.qos_profile
    reliable = qos.reliability != ReliabilityPolicy.BEST_EFFORT
    words = ['reliable' if reliable else 'best effort']
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append('transient local')
    return End(matching.full_name(end), plain(end.topic_type), ', '.join(words), reliable)


def _unused(message: object) -> None:
    """Stand in for a callback: the subscriptions are polled."""
