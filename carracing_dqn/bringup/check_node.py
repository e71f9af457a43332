# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A node that listens to a car for some seconds and, if asked to, turns it left and right."""
from __future__ import annotations

import time
from typing import Any

from carracing_dqn.simulation.fit import (
    COMPRESSED_TYPE, IMAGE_TYPE, PLAIN_TYPE, Seen, STAMPED_TYPE,
)
from dqn_policy_node.camera import Camera
from dqn_policy_node.command_stage import CommandStage
from dqn_policy_node.settings import PolicySettings
from msgs_bridge import topics
from msgs_bridge.adaptive_subscription import AdaptiveSubscription
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.images import compressed_to_array
from msgs_bridge.listening_node import node_of_a_command
from msgs_bridge.matching import (
    as_known, deaf_subscriptions, publishers_of, subscriptions_of, topics_of,
)
from msgs_bridge.message_types import message_class
from msgs_bridge.plain_text import plain
from msgs_bridge.qos import qos_profile
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.twists import Command, fill_twist
import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

# Fast DDS announces itself every 3 s, and one announcement may get lost
FIND_SECONDS = 6.5
# after the camera was found, the others are
SETTLE_SECONDS = 1.0
# a gentle start, then full lock, so that whatever steers shows it; twice, because a camera may
# move by itself
LEFT, RIGHT = ('left', 0.175, Command(0.2, 1.0)), ('right', 0.175, Command(0.2, -1.0))
PHASES = (('', 0.3, Command(0.4, 0.0)), LEFT, RIGHT, LEFT, RIGHT)
# how long the last twist, which lets it stand, may take to arrive
ACK_SECONDS = 0.5
# frames that are kept of each phase
MAX_FRAMES = 300
MAX_IMAGES = 100_000
TURN = 0.05
"""Seconds that the executor may wait for a message."""


def look(
    settings: PolicySettings, frame: tuple[int, int], *, namespace: str, remaps: dict[str, str],
    seconds: float, nudge: bool,
) -> Seen:
    """
    Return what a car did while it was looked at.

    Args:
        settings: of the policy that is to drive it.
        frame: (width, height) that the model sees.
        namespace: absolute, of the car's topics.
        remaps: relative name -> name of its topics.
        seconds: how long to listen.
        nudge: whether to drive it meanwhile, ahead first, then left and right, twice; not done
            where another node drives.

    Raises:
        BridgeError: the machine lacks what every node needs, or a topic has no such name.
    """
    node, executor = node_of_a_command('carracing_check', namespace)
    try:
        return _Look(node, executor, settings, frame, remaps).run(seconds, nudge)
    except rclpy.exceptions.InvalidTopicNameException as error:
        raise BridgeError(f'topics of the profile: {str(error).splitlines()[0]}') from None
    finally:
        rclpy.try_shutdown(context=node.context)


class _Look:
    def __init__(
        self, node: Any, executor: SingleThreadedExecutor, settings: PolicySettings,
        frame: tuple[int, int], remaps: dict[str, str],
    ) -> None:
        self._node, self._executor, self._settings = node, executor, settings
        self._camera = Camera(settings, frame[1], frame[0])
        self._stage = CommandStage(settings)
        self._image_name, self._cmd_vel_name, self._step_name = (
            remaps.get(topic.name, topic.name)
            for topic in (topics.IMAGE, topics.CMD_VEL, topics.STEP))
        self._seen = Seen(node.resolve_topic_name(self._image_name),
                          node.resolve_topic_name(self._cmd_vel_name))
        self._publisher: Any = None
        self._phase = PHASES[0]
        self._twist_at: float | None = None

    def run(self, seconds: float, nudge: bool) -> Seen:
        found_by = time.monotonic() + FIND_SECONDS
        while not publishers_of(self._node, self._seen.image_topic) and (
                time.monotonic() < found_by):
            self._spin(TURN)
        self._spin(SETTLE_SECONDS)
        self._note_graph()
        compressed = self._settings.camera_compressed
        wanted = COMPRESSED_TYPE if compressed else IMAGE_TYPE
        if wanted in self._seen.image_types:
            if nudge and not self._seen.drivers:
                stamped = self._settings.cmd_vel_stamped
                self._twist_class = message_class(STAMPED_TYPE if stamped else PLAIN_TYPE)
                self._publisher = self._node.create_publisher(
                    self._twist_class, self._cmd_vel_name, qos_profile(topics.CMD_VEL))
            subscription = AdaptiveSubscription(
                self._node, message_class(wanted), self._image_name, self._on_image,
                qos_profile(topics.IMAGE))
            subscription.watch()
            try:
                for phase in PHASES if self._publisher else PHASES[:1]:
                    self._phase = phase
                    self._seen.frames.append((phase[0], []))
                    self._spin(seconds * (phase[1] if self._publisher else 1.0))
            finally:
                # after Ctrl-C, too: a robot may hold the last twist for good
                self._stop()
        # those who answer images may have come since
        self._note_graph()
        return self._seen

    def _stop(self) -> None:
        """Let what was driven stand, and wait until it has heard that."""
        if self._publisher is not None:
            self._publisher.publish(self._twist(self._stage.stop(), None))
            self._publisher.wait_for_all_acked(Duration(seconds=ACK_SECONDS))

    def _spin(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            try:
                self._executor.spin_once(timeout_sec=TURN)
            except ExternalShutdownException:
                return
            except Exception as error:
                # the middleware refuses some messages by exceptions of its own, of any kind
                self._seen.refused.add(plain(error))
                time.sleep(TURN)

    def _note_graph(self) -> None:
        node, seen = self._node, self._seen
        publishers = publishers_of(node, seen.image_topic)
        seen.image_types = sorted({one.topic_type for one in publishers})
        seen.offered = sorted({
            one.qos_profile.reliability.name.lower().replace('_', ' ') for one in publishers})
        seen.other_images = sorted(
            name for name, types in as_known(topics_of, node).items()
            if {IMAGE_TYPE, COMPRESSED_TYPE} & set(types) and publishers_of(node, name))
        stamped = self._settings.cmd_vel_stamped
        listeners = subscriptions_of(node, seen.cmd_vel_topic)
        seen.twist_types = sorted({one.topic_type for one in listeners})
        seen.deaf = deaf_subscriptions(
            [one for one in listeners if one.topic_type in (PLAIN_TYPE, STAMPED_TYPE)],
            STAMPED_TYPE if stamped else PLAIN_TYPE, qos_profile(topics.CMD_VEL))
        seen.drivers = sorted({
            plain(f'{one.node_namespace.rstrip("/")}/{one.node_name}')
            for one in publishers_of(node, seen.cmd_vel_topic)
            if one.node_name != node.get_name()})
        seen.steps = bool(publishers_of(node, node.resolve_topic_name(self._step_name)))

    def _on_image(self, message: Any) -> None:
        seen = self._seen
        if len(seen.arrivals) >= MAX_IMAGES:
            return
        stamp = message.header.stamp
        seen.arrivals.append(time.monotonic())
        seen.stamps.append(to_nanoseconds(stamp))
        if self._settings.camera_compressed:
            seen.encodings.add(plain(message.format))
        else:
            seen.encodings.add(plain(message.encoding))
            seen.sizes.add((message.width, message.height))
        command, (_, series) = self._phase[2], seen.frames[-1]
        try:
            if not seen.sizes:
                # a compressed one says it when it is unpacked, which for each would take too long
                height, width, _ = compressed_to_array(message).shape
                seen.sizes.add((width, height))
            frame = self._camera.frame(message)
            if len(series) < MAX_FRAMES:
                series.append(frame.copy())
        except MessageError as error:
            seen.refused.add(plain(error))
        if self._publisher is not None:
            now = time.monotonic()
            gap = 0.0 if self._twist_at is None else now - self._twist_at
            self._twist_at = now
            self._publisher.publish(self._twist(self._stage.twist(command, gap), stamp))

    def _twist(self, command: Command, stamp: Any) -> Any:
        message = self._twist_class()
        if not self._settings.cmd_vel_stamped:
            return fill_twist(message, command)
        if stamp is not None:
            message.header.stamp = stamp
        fill_twist(message.twist, command)
        return message
