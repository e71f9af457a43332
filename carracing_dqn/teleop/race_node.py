# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
race_node: a person drives in a window, in the place of a policy.

Purpose: show the picture, the lap and what a model had made of it by then, and answer every image
with the command of keys or joysticks, on the same `cmd_vel` with the same stamps as a policy, so
that it is recorded and learned from like one. A lap begins with the first gas.

Subscribes: `image_raw`, `step`, `joy` (sensor_msgs/Joy). Publishes: `cmd_vel`, `/diagnostics`,
with how far the lap is. Service: `~/enable` (std_srvs/SetBool). Parameters:
`carracing_dqn/teleop/settings.py`.

Behaviour when things go wrong: without a screen it ends with one line and code 2; keys count as
let go when the window is left; a joystick that lacks an axis is named in the diagnostics; Escape
or closing the window ends it, with one zero twist.
"""
from __future__ import annotations

import sys
import time
from typing import Any

from carracing_dqn.teleop.hand import HeldKeys
from carracing_dqn.teleop.hand_node import HandNode
from carracing_dqn.teleop.race import Race
from carracing_dqn.teleop.race_window import RaceWindow
from carracing_dqn.teleop.rivals import read_rivals
from carracing_dqn.teleop.settings import RaceSettings
from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.errors import MessageError
from msgs_bridge.images import compressed_to_array, image_to_array
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import Finished, run_node
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import read_step
from msgs_bridge.twists import Command

SHOW_SECONDS = 1 / 30


class RaceNode(HandNode):
    """Answers images by the keys and joysticks of a window."""

    def __init__(self) -> None:
        """Open the window and wait for images."""
        super().__init__('race_node', RaceSettings)
        settings = self.settings
        self._keys = HeldKeys(settings)
        name, rivals = read_rivals(settings.rivals) if settings.rivals else ('', {})
        self._race = Race(settings.laps, name, rivals)
        self._window = RaceWindow(settings.scale, 'carracing race')
        self._pixels, self._shown_stamp = None, 0
        self._leaving = False
        self.subscription(topics.STEP, self._on_step)
        self.create_timer(SHOW_SECONDS, self._show)

    def on_image(self, message: Any) -> None:
        """Keep the picture, and answer when its time has come."""
        compressed = self.settings.image_compressed
        self._pixels = (compressed_to_array if compressed else image_to_array)(message)
        self._shown_stamp = to_nanoseconds(message.header.stamp)
        super().on_image(message)

    def _on_step(self, message: Any) -> None:
        self._race.take(
            read_step(read_named_values(message)), to_nanoseconds(message.header.stamp))

    def _show(self) -> None:
        self._window.show(self._pixels, self._shown_stamp, self._race.view())

    def look_at_keys(self, now: float) -> None:
        """Take what keys and joysticks have done; end when the window is closed."""
        try:
            self._leaving = self._window.poll(self._keys, self.joystick, now)
        except MessageError as error:
            self.warn_of('joystick', str(error))
        if self._leaving:
            # how far the lap is, for who adds up what was driven
            self.publish_diagnostics()
            raise Finished

    def of_keys(self, now: float) -> Command:
        """Return what they want."""
        return self._keys.command(now)

    def let_go(self) -> None:
        """Let go of all keys."""
        self._keys.release_all()

    def keys_are_there(self) -> bool:
        """Return whether there are keys: a window has them."""
        return True

    def may_answer(self) -> bool:
        """Return whether the lap has begun, which it does with gas."""
        if not super().may_answer():
            return False
        if not self._race.started and self._race.step is not None:
            self._race.started = self.wanted(time.monotonic()).linear > 0
        return self._race.started

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what drives and how far the lap is."""
        level, summary, values = super().health()
        if self._race.step is None and self._pixels is not None:
            level = DiagnosticStatus.WARN
            summary = 'no lap can begin: images come, but no step'
        elif self._race.step is not None and not self._race.started:
            level, summary = DiagnosticStatus.OK, f'lap {self._race.lap} waits for the driver'
        values.update(self._race.under_way, laps=self._race.lap, leaving=int(self._leaving))
        return level, summary, values

    def close(self) -> None:
        """Close the window and stop the car."""
        self._window.close()
        super().close()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped or its window closed."""
    return run_node(RaceNode, args)


if __name__ == '__main__':
    sys.exit(main())
