# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes share that let a person drive: images in, commands out, at the pace of time."""
from __future__ import annotations

import time
from typing import Any

from builtin_interfaces.msg import Time
from carracing_dqn.teleop.hand import joined, Joystick
from carracing_dqn.teleop.settings import HandSettings
from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.command_stage import CommandStage
from geometry_msgs.msg import Twist, TwistStamped
from msgs_bridge import topics
from msgs_bridge.node_shell import NodeShell
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds
from msgs_bridge.twists import Command, fill_twist
from std_srvs.srv import SetBool

# how often hands are looked at and an answer may be due; seconds
BEAT_SECONDS = 0.005
# a longer step between two stamps is a new episode, and not waited for, seconds; unless the one
# before was about as long: then frames last so long
LONGEST_STEP = 0.5
SAME_STEP = 1.5
SILENCE_SECONDS = 2.0


class HandNode(NodeShell):
    """
    Answers images with what a person wants, by a joystick on `joy` and by keys.

    A subclass has the keys: `look_at_keys` and `of_keys`, and says whether they are there. A
    robot may hold the last twist for good, so that one of zero is sent when no image has come for
    a while, and at the end.
    """

    has_last_word = True

    def __init__(self, name: str, settings_class: type[HandSettings]) -> None:
        """Wait for images."""
        super().__init__(name, settings_class)
        settings = self.settings
        self.joystick = Joystick(settings)
        self._stage = CommandStage(settings)
        self._enabled, self._connected = True, False
        # stamp of the image that waits for its answer, and when that is due on the wall
        self._waiting: Time | None = None
        self._due = 0.0
        self._stamp: int | None = None
        # seconds between the last two stamps
        self._step = 0.0
        self._answered_at: float | None = None
        # whether the last twist let it stand
        self._halted = True
        self._cmd_vel = self.publisher(
            topics.CMD_VEL,
            type_name=None if settings.cmd_vel_stamped else topics.PLAIN_TWIST_TYPE)
        self._images = self.subscription(
            topics.IMAGE, self.on_image, newest=True,
            type_name=topics.COMPRESSED_TYPE if settings.image_compressed else None)
        self.subscription(topics.JOY, self._on_joy)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.create_timer(BEAT_SECONDS, self._beat)

    def look_at_keys(self, now: float) -> None:
        """Take what the keys have done; `now` in s."""
        raise NotImplementedError

    def of_keys(self, now: float) -> Command:
        """Return what the keys want; `now` in s."""
        raise NotImplementedError

    def let_go(self) -> None:
        """Let go of all keys."""
        raise NotImplementedError

    def keys_are_there(self) -> bool:
        """Return whether there are keys at all."""
        raise NotImplementedError

    def may_answer(self) -> bool:
        """Return whether the image that waits may be answered."""
        self._connected = self._connected or (
            self._cmd_vel.get_subscription_count() >= self.settings.wait_for_subscribers)
        return self._enabled and self._connected

    def on_image(self, message: Any) -> None:
        """Take an image, which is answered when its time has come."""
        stamp = to_nanoseconds(message.header.stamp)
        now = time.monotonic()
        before, self._stamp = self._stamp, stamp
        factor = self.settings.real_time_factor
        step = 0.0 if before is None else (stamp - before) / NANOSECONDS
        usual = step <= LONGEST_STEP or step / SAME_STEP <= self._step <= step * SAME_STEP
        answered = self._answered_at is not None and self._waiting is None
        if factor and step > 0 and usual and answered:
            # from when the last was due, so that nothing adds up, unless it is late already
            self._due = max(self._due + step / factor, now - step / factor)
        elif step:
            # as well when the last was not waited for: time is somebody else's, and runs faster
            self._due = now
        self._step = step or self._step
        self._waiting = message.header.stamp
        self._answer(now)

    def _on_joy(self, message: Any) -> None:
        self.joystick.take(message.axes, message.buttons, time.monotonic())

    def _beat(self) -> None:
        now = time.monotonic()
        self.look_at_keys(now)
        self._answer(now)
        if (not self._halted and self._waiting is None
                and now - self._answered_at > SILENCE_SECONDS):
            self._halt()

    def _halt(self) -> None:
        """Send one zero twist, stamped zero."""
        self._halted = True
        self._send(self._stage.stop(), Time())

    def wanted(self, now: float) -> Command:
        """Return what the person wants; `now` in s."""
        return joined(self.of_keys(now), self.joystick.command(now))

    def _answer(self, now: float) -> None:
        """Answer the image that waits, if its time has come."""
        if self._waiting is None or now < self._due or not self.may_answer():
            return
        wanted = self.wanted(now)
        gap = 0.0 if self._answered_at is None else now - self._answered_at
        self._answered_at, self._halted = now, False
        self.counts['answers'] += 1
        self._send(self._stage.twist(wanted, gap), self._waiting)
        self._waiting = None

    def _send(self, command: Command, stamp: Time) -> None:
        """Publish a command with the very stamp of the image, which may say no time there is."""
        if not self.settings.cmd_vel_stamped:
            self._cmd_vel.publish(fill_twist(Twist(), command))
            return
        message = TwistStamped()
        message.header.stamp = stamp
        fill_twist(message.twist, command)
        self._cmd_vel.publish(message)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = request.data
        if not self._enabled:
            # a pedal that stays would drive on as soon as it is enabled
            self.let_go()
            self._halt()
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled'
        return response

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what drives, or what is missing."""
        now = time.monotonic()
        joystick = now - self.joystick.heard_at <= self.settings.stale_after
        keys = self.keys_are_there()
        values = {'enabled': self._enabled, 'keyboard': keys, 'joystick': joystick}
        if not self._enabled:
            return DiagnosticStatus.WARN, 'disabled by ~/enable', values
        if not joystick and not keys:
            return DiagnosticStatus.WARN, 'neither a terminal nor a joystick: it lets go', values
        if self._answered_at is None or now - self._answered_at > SILENCE_SECONDS:
            why = '' if self._images.publishers else f': nobody publishes {self._images.name}'
            return DiagnosticStatus.WARN, f'no image{why}', values
        hands = ' and '.join(['keyboard'] * keys + ['joystick'] * joystick)
        return DiagnosticStatus.OK, f'driving by {hands}', values

    def close(self) -> None:
        """Stop the car."""
        if self.context.ok() and self._answered_at is not None:
            self._halt()
