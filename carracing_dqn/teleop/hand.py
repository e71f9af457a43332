# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From keys and the axes of a joystick to commands."""
from __future__ import annotations

from collections.abc import Sequence
import math

from carracing_dqn.teleop.settings import (
    HandSettings, HeldKeySettings, TerminalKeySettings,
)
from msgs_bridge.errors import MessageError
from msgs_bridge.terminal_keys import ARROWS, DOWN, LEFT, RIGHT, UP
from msgs_bridge.twists import Command, STOP

LET_GO = 'let go'
KEYS = {**ARROWS, b'w': UP, b's': DOWN, b'a': LEFT, b'd': RIGHT, b' ': LET_GO}
# seconds of steering that a first look, or one after a pause, may count
LONGEST_TURN = 0.05


class Keyboard:
    """A pedal that stays where it is, and steering that is let go by itself."""

    def __init__(self, settings: TerminalKeySettings) -> None:
        """Let go of everything."""
        self._settings = settings
        self._linear = self._angular = 0.0
        self._steered_at = -math.inf

    def press(self, key: str, now: float) -> None:
        """Take a key at a time in s."""
        step, lock = self._settings.key_step, self._settings.key_steering
        if key == LET_GO:
            self._linear = self._angular = 0.0
        elif key in (UP, DOWN):
            self._linear = max(-1.0, min(1.0, self._linear + (step if key == UP else -step)))
            # sums of 0.2 that come back to 0 are 0
            self._linear = round(self._linear, 6)
        else:
            self._angular = lock if key == LEFT else -lock
            self._steered_at = now

    def command(self, now: float) -> Command:
        """Return what is wanted at a time in s."""
        held = now - self._steered_at <= self._settings.key_hold
        return Command(self._linear, self._angular if held else 0.0)


class HeldKeys:
    """Pedals that are pressed or not, and steering that grows while its key is held."""

    def __init__(self, settings: HeldKeySettings) -> None:
        """Hold nothing."""
        self._settings = settings
        self._held: set[str] = set()
        self._steering = 0.0
        self._at = -math.inf

    def press(self, key: str) -> None:
        """Hold a key: `UP`, `DOWN`, `LEFT` or `RIGHT`."""
        self._held.add(key)

    def release(self, key: str) -> None:
        """Let a key go, whether it was held or not."""
        self._held.discard(key)

    def release_all(self) -> None:
        """Let go of everything."""
        self._held.clear()

    def command(self, now: float) -> Command:
        """Return what is wanted at a time in s, which never goes back."""
        settings, held = self._settings, self._held
        side = (LEFT in held) - (RIGHT in held)
        passed = min(now - self._at, LONGEST_TURN)
        self._at = now
        # from one side to the other it goes through the middle at once
        begun = self._steering if self._steering * side > 0 else 0.0
        self._steering = side * min(
            abs(begun) + settings.steering_rate * passed, settings.steering) if side else 0.0
        if DOWN in held:
            return Command(-settings.brake, self._steering)
        turned = abs(self._steering) / settings.steering
        gas = settings.gas * (1 - turned * (1 - settings.gas_in_bends))
        return Command(gas if UP in held else 0.0, self._steering)


class Joystick:
    """The axes and buttons of a sensor_msgs/Joy."""

    def __init__(self, settings: HandSettings) -> None:
        """Nothing has come yet."""
        self._settings = settings
        self._command = STOP
        self.heard_at = -math.inf

    def take(self, axes: Sequence[float], buttons: Sequence[int], now: float) -> None:
        """
        Take a message at a time in s.

        Raises:
            MessageError: it lacks an axis or the button, or an axis is no number.
        """
        settings = self._settings
        linear = self._axis(axes, settings.linear_axis)
        angular = self._axis(axes, settings.angular_axis)
        button = settings.deadman_button
        if button >= len(buttons):
            raise MessageError(f'joy has {len(buttons)} buttons; deadman_button is {button}')
        held = button < 0 or bool(buttons[button])
        self._command = Command(linear, angular) if held else STOP
        self.heard_at = now

    def command(self, now: float) -> Command:
        """Return what is wanted at a time in s; nothing once it has fallen silent."""
        fresh = now - self.heard_at <= self._settings.stale_after
        return self._command if fresh else STOP

    def _axis(self, axes: Sequence[float], number: int) -> float:
        if number < 0:
            return 0.0
        if number >= len(axes):
            raise MessageError(f'joy has {len(axes)} axes; number {number} is wanted')
        value = float(axes[number])
        if not math.isfinite(value):
            raise MessageError(f'axis {number} of joy is {value}')
        zone = self._settings.dead_zone
        if abs(value) <= zone:
            return 0.0
        # from the edge of the dead zone on, so that nothing jumps there
        return math.copysign(min(1.0, (abs(value) - zone) / (1 - zone)), value)


def joined(first: Command, second: Command) -> Command:
    """Return two hands as one: where both say something, the larger counts."""
    return Command(*(max(pair, key=abs) for pair in zip(first, second)))
