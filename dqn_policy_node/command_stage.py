# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""From the commands of a policy to the twists of a robot: units, limits, rates of change."""
from __future__ import annotations

import dataclasses
import math

from msgs_bridge.command_scale import CommandScale
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import setting
from msgs_bridge.twists import Command, STOP

# a longer pause between two commands counts as this long, so that nothing jumps after it; seconds
LONGEST_PAUSE = 0.5


@dataclasses.dataclass(frozen=True)
class CommandSettings(CommandScale):
    """How a robot takes commands; the defaults are those of our simulators."""

    drive: str = setting(
        'direct', 'direct: commands are scaled; ackermann: linear is a pedal that changes the '
        'speed, angular turns the front wheels, and out come speed and yaw rate, scaled like '
        'commands (the trainer cannot learn from those)', choices=('direct', 'ackermann'))
    linear_low: float = setting(
        -1000.0, 'least linear.x, m/s', low=-1000.0, high=1000.0)
    linear_high: float = setting(
        1000.0, 'greatest linear.x, m/s', low=-1000.0, high=1000.0)
    linear_rate: float = setting(
        0.0, 'most that linear.x changes, m/s^2; 0 = at once', low=0.0, high=10000.0)
    angular_limit: float = setting(
        1000.0, 'greatest angular.z to either side, rad/s', low=0.0, high=1000.0)
    angular_rate: float = setting(
        0.0, 'most that angular.z changes, rad/s^2; 0 = at once', low=0.0, high=10000.0)
    acceleration: float = setting(
        1.0, 'ackermann: change of speed at full gas, m/s^2', low=0.0, high=1000.0)
    deceleration: float = setting(
        2.0, 'ackermann: change of speed at full brake, m/s^2', low=0.0, high=1000.0)
    coasting: float = setting(
        0.2, 'ackermann: change of speed without pedals, m/s^2', low=0.0, high=1000.0)
    wheelbase: float = setting(
        0.3, 'ackermann: distance of the axles, m', low=0.01, high=100.0)
    steering_limit: float = setting(
        0.4, 'ackermann: angle of the front wheels at full lock, rad', low=0.0, high=1.5)

    def __post_init__(self) -> None:
        """Check what concerns two values; raises SettingsError."""
        if self.linear_low > self.linear_high:
            raise SettingsError(f'linear_low is {self.linear_low}; accepted: up to linear_high, '
                                f'{self.linear_high}')


class CommandStage:
    """Makes twists out of commands, one after the other."""

    def __init__(self, settings: CommandSettings) -> None:
        """Stand still."""
        self._settings = settings
        self._last = STOP
        self._speed = 0.0

    def stop(self) -> Command:
        """Return the twist that stops the robot at once, and begin anew from there."""
        self._last, self._speed = STOP, 0.0
        return STOP

    def twist(self, command: Command, seconds: float) -> Command:
        """
        Return what to send for a command.

        Args:
            command: of the policy, within [-1, 1].
            seconds: since the command before; what is beyond 0 to 0.5 s counts as that.

        Returns:
            linear.x in m/s and angular.z in rad/s, within limits and rates.
        """
        settings = self._settings
        seconds = min(max(seconds, 0.0), LONGEST_PAUSE)
        wanted = settings.to_robot(
            command if settings.drive == 'direct' else self._ackermann(command, seconds))
        limit = settings.angular_limit
        self._last = Command(
            _towards(self._last.linear, _within(
                wanted.linear, settings.linear_low, settings.linear_high),
                settings.linear_rate * seconds if settings.linear_rate else math.inf),
            _towards(self._last.angular, _within(wanted.angular, -limit, limit),
                     settings.angular_rate * seconds if settings.angular_rate else math.inf))
        return self._last

    def _ackermann(self, command: Command, seconds: float) -> Command:
        """Return speed and yaw rate of a car with a pedal and front wheels (bicycle model)."""
        settings = self._settings
        if command.linear > 0:
            self._speed += command.linear * settings.acceleration * seconds
        else:
            slowing = max(-command.linear * settings.deceleration, settings.coasting)
            self._speed = max(self._speed - slowing * seconds, 0.0)
        low, high = sorted(settings.from_robot(Command(limit, 0.0)).linear
                           for limit in (settings.linear_low, settings.linear_high))
        self._speed = _within(self._speed, low, high)
        angle = command.angular * settings.steering_limit
        return Command(self._speed, self._speed * math.tan(angle) / settings.wheelbase)


def _within(value: float, low: float, high: float) -> float:
    return max(low, min(high, value))


def _towards(value: float, wanted: float, most: float) -> float:
    """Return the value moved towards another by at most so much."""
    return wanted if abs(wanted - value) <= most else value + math.copysign(most, wanted - value)
