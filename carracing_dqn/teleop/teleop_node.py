# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
teleop_node: a person drives, in the place of a policy.

Purpose: answer every image with the command of the keyboard of its terminal or of a joystick, on
the same `cmd_vel` with the same stamps as a policy, so that it is recorded and learned from like
one. A simulator in lockstep is answered at the pace of its own time.

Subscribes: `image_raw` (its stamps), `joy` (sensor_msgs/Joy). Publishes: `cmd_vel`,
`/diagnostics`. Service: `~/enable` (std_srvs/SetBool): disabled it sends one zero twist, then
nothing. Parameters: `carracing_dqn/teleop/settings.py`.

Behaviour when things go wrong: a joystick that falls silent or lacks an axis counts as let go,
and is named in the diagnostics; without a terminal there are no keys; at the end one zero twist
is sent.
"""
from __future__ import annotations

import sys
import time
from typing import Any

from carracing_dqn.teleop.hand import joined, Joystick, Keyboard, KEYS
from carracing_dqn.teleop.settings import TeleopSettings
from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.command_stage import CommandStage
from geometry_msgs.msg import Twist, TwistStamped
from msgs_bridge import topics
from msgs_bridge.node_shell import NodeShell, run_node
from msgs_bridge.stamps import NANOSECONDS, set_stamp, to_nanoseconds
from msgs_bridge.terminal_keys import keys_in, TerminalKeys
from msgs_bridge.twists import Command, fill_twist
from std_srvs.srv import SetBool

# how often keys are read and an answer may be due; seconds
BEAT_SECONDS = 0.005
# a longer step between two stamps is a new episode, and not waited for
LONGEST_STEP = 0.5
SILENCE_SECONDS = 2.0


class TeleopNode(NodeShell):
    """Answers images with what a person wants."""

    def __init__(self) -> None:
        """Take the terminal and wait for images."""
        super().__init__('teleop_node', TeleopSettings)
        settings = self.settings
        self._keyboard, self._joystick = Keyboard(settings), Joystick(settings)
        self._keys = TerminalKeys() if settings.keyboard else None
        self._stage = CommandStage(settings)
        self._enabled = True
        # stamp of the image that waits for its answer, and when that is due on the wall
        self._waiting: int | None = None
        self._due = 0.0
        self._stamp: int | None = None
        self._answered_at: float | None = None
        self._cmd_vel = self.publisher(
            topics.CMD_VEL,
            type_name=None if settings.cmd_vel_stamped else topics.PLAIN_TWIST_TYPE)
        self._images = self.subscription(
            topics.IMAGE, self._on_image, newest=True,
            type_name=topics.COMPRESSED_TYPE if settings.image_compressed else None)
        self.subscription(topics.JOY, self._on_joy)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.create_timer(BEAT_SECONDS, self._beat)
        if self._keys is not None and self._keys.there:
            self.get_logger().info('arrows or w a s d: up and down the pedal, left and right; '
                                   'space lets go; Ctrl-C ends')

    def _on_image(self, message: Any) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        now = time.monotonic()
        before, self._stamp = self._stamp, stamp
        factor = self.settings.real_time_factor
        step = 0.0 if before is None else (stamp - before) / NANOSECONDS
        if not factor or not 0 < step <= LONGEST_STEP or self._answered_at is None:
            self._due = now
        else:
            # from when the last was due, so that nothing adds up, unless it is late already
            self._due = max(self._due + step / factor, now - step / factor)
        self._waiting = stamp
        self._answer(now)

    def _on_joy(self, message: Any) -> None:
        self._joystick.take(message.axes, message.buttons, time.monotonic())

    def _beat(self) -> None:
        now = time.monotonic()
        if self._keys is not None:
            for key in keys_in(self._keys.read(), KEYS):
                self._keyboard.press(key, now)
        self._answer(now)

    def _answer(self, now: float) -> None:
        """Answer the image that waits, if its time has come."""
        if self._waiting is None or now < self._due or not self._enabled:
            return
        wanted = joined(self._keyboard.command(now), self._joystick.command(now))
        gap = 0.0 if self._answered_at is None else now - self._answered_at
        self._answered_at = now
        self.counts['answers'] += 1
        self._send(self._stage.twist(wanted, gap), self._waiting)
        self._waiting = None

    def _send(self, command: Command, stamp: int) -> None:
        if not self.settings.cmd_vel_stamped:
            self._cmd_vel.publish(fill_twist(Twist(), command))
            return
        message = TwistStamped()
        set_stamp(message.header.stamp, stamp)
        fill_twist(message.twist, command)
        self._cmd_vel.publish(message)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = request.data
        if not self._enabled:
            self._send(self._stage.stop(), 0)
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled'
        return response

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what drives, or what is missing."""
        now = time.monotonic()
        joystick = now - self._joystick.heard_at <= self.settings.stale_after
        keys = self._keys is not None and self._keys.there
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
        """Give the terminal back, and stop the car."""
        if self._keys is not None:
            self._keys.close()
        if self.context.ok() and self._answered_at is not None:
            self._send(self._stage.stop(), 0)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(TeleopNode, args)


if __name__ == '__main__':
    sys.exit(main())
