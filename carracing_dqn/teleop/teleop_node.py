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
and is named in the diagnostics; without a terminal there are no keys, and with one that has gone
they count as let go; when no image has come for two seconds, and at the end, one zero twist is
sent.
"""
from __future__ import annotations

import sys
import time

from carracing_dqn.teleop.hand import Keyboard, KEYS, LET_GO
from carracing_dqn.teleop.hand_node import HandNode
from carracing_dqn.teleop.settings import TeleopSettings
from msgs_bridge.node_shell import run_node
from msgs_bridge.terminal_keys import keys_in, TerminalKeys
from msgs_bridge.twists import Command


class TeleopNode(HandNode):
    """Answers images by the keys of a terminal."""

    def __init__(self) -> None:
        """Take the terminal and wait for images."""
        super().__init__('teleop_node', TeleopSettings)
        self._keyboard = Keyboard(self.settings)
        self._keys = TerminalKeys() if self.settings.keyboard else None
        if self.keys_are_there():
            self.get_logger().info('arrows or w a s d: up and down the pedal, left and right; '
                                   'space lets go; Ctrl-C ends')

    def look_at_keys(self, now: float) -> None:
        """Take the keys that were pressed."""
        if self._keys is not None:
            for key in keys_in(self._keys.read(), KEYS):
                self._keyboard.press(key, now)
            if not self._keys.there:
                self.let_go()

    def of_keys(self, now: float) -> Command:
        """Return what they want."""
        return self._keyboard.command(now)

    def let_go(self) -> None:
        """Let go of the pedal and the wheel."""
        self._keyboard.press(LET_GO, time.monotonic())

    def keys_are_there(self) -> bool:
        """Return whether there is a terminal."""
        return self._keys is not None and self._keys.there

    def close(self) -> None:
        """Give the terminal back, and stop the car."""
        if self._keys is not None:
            self._keys.close()
        super().close()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(TeleopNode, args)


if __name__ == '__main__':
    sys.exit(main())
