# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
pyRacerz, a game by Jujucece, as a `Simulator`: its tracks, its car, its own rules for a lap.

The game's track is a picture and a function map: green is the grip (255 on the road, 0 a wall),
red the number of a checkpoint. Positions are pixels of the track picture, x to the right, y down.
"""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import itertools
import math
from typing import Any

from carracing_dqn.simulators.pyracerz_game import load_game
from carracing_dqn.simulators.pyracerz_views import CarRacingView, RawView
from carracing_sim_node.appearance import PIXELS_PER_UNIT, SteeringColumn
from msgs_bridge.errors import SimulatorError
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import numbers, setting
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.twists import Command
import numpy as np

# of the game's loop
STEP_SECONDS = 0.01
# checkpoint n of the function map has this red value times n
RED_STEP = 16
GRIP = 255
# what the game's keys change in a step
THROTTLE_RISE, THROTTLE_FALL, BRAKE_RISE = 0.1, 0.05, 0.2
# speeds of rotation below this are made 0 by the game, rad a step
LEAST_TURN = 0.003
# the game adds this to it for each step of full steering, and keeps 0.8 of it: 0.035 in the end
TURN_RISE, TURN_KEPT = 0.007, 0.8
# full steering, of which the smallest part that moves the car from straight on
LEAST_STEERING = 1.05 * LEAST_TURN / TURN_RISE
# slower than this the car counts as standing, pixels a step
STANDING = 0.05
# at the start of an episode, at most: pixels, rad, share of the top speed
PLACE_JITTER, ANGLE_JITTER, SPEED_JITTER = 10.0, 0.1, 0.3
# of all checkpoints of a lap, and of each frame, as in CarRacing
LAP_REWARD, FRAME_REWARD = 1000.0, -0.1


@dataclasses.dataclass(frozen=True)
class PyRacerzSettings:
    """What can be set on pyRacerz."""

    track: str = setting('bio', "one of the game's tracks: bio, city, desert, formula, http, "
                         'kart, wave')
    direction: str = setting('normal', 'which way round', choices=('normal', 'reverse'))
    level: int = setting(1, "the game's level: top speed 350, 450 or 600 pixels/s", low=1, high=3)
    steps_per_frame: int = setting(
        2, "the game's steps of 1/100 s to a frame", low=1, high=10)
    laps: int = setting(1, 'laps of an episode', low=1, high=100)
    max_episode_frames: int = setting(
        1250, 'frames after which an episode is truncated', low=1, high=10**7)
    start_variation: float = setting(
        1.0, "share of what starts differ by: 0 is the game's first place, at rest; up to 1 it is "
        'one of its three, 10 pixels and 0.1 rad beside it, with up to 0.3 of the top speed',
        low=0.0, high=1.0)
    driver: str = setting(
        'command', "who drives: the commands, or the game's own robot, whatever they say",
        choices=('command', 'robot'))
    picture: str = setting(
        'raw', "the frame: the game's colours and car, or all of it as in CarRacing",
        choices=('raw', 'carracing'))
    scale: float = setting(
        4.0, 'pixels of the track picture to one of the frame, across', low=0.5, high=20.0)
    stretch: float = setting(
        1.0, 'the same from top to bottom, as a share of that; 0.8 in CarRacing',
        low=0.2, high=5.0)
    road_level: int = setting(
        104, "picture carracing: gray level of the road; CarRacing's tiles have 102 once they "
        'are visited, 104 on average before', low=0, high=255)
    steering: str = setting(
        'direct', "direct: angular is the game's steering; column: it turns the wheels as slowly "
        'as in CarRacing, and less than the game takes is given in pulses',
        choices=('direct', 'column'))
    reverse_gear: bool = setting(
        True, 'whether the brake, held at rest, drives backwards as in the game')
    frame_id: str = setting('camera', 'frame_id of the images')


class PyRacerz(Simulator):
    """A lap of pyRacerz, alone on the track, seen from above with the car's nose up."""

    Settings = PyRacerzSettings
    deterministic = True
    draws_on_request = True

    def __init__(self, settings: PyRacerzSettings) -> None:
        """
        Load track and car.

        Raises:
            SimulatorError: the game is not installed, or has no such track.
        """
        game = load_game()
        names = sorted(game.track.getAvailableTrackNames())
        if settings.track not in names:
            raise SimulatorError(
                f'track is {plain(settings.track)!r}; accepted: {", ".join(names)}')
        self._settings = settings
        self._track = game.track.Track(settings.track, int(settings.direction == 'reverse'))
        # the game's robot has the car, the count of checkpoints and hands for the wheel
        self._player = game.player.RobotPlayer(1, settings.level)
        self._car = self._player.car
        view = self._track.track, self._car, settings.scale, settings.stretch
        self._view: Any = (RawView(*view) if settings.picture == 'raw'
                           else CarRacingView(*view, settings.road_level))
        self._column = SteeringColumn()
        # pixels of the track to a unit of CarRacing's world
        self._unit = settings.scale * PIXELS_PER_UNIT
        self._random = np.random.default_rng()
        self.frame_seconds = settings.steps_per_frame * STEP_SECONDS
        # by these a bag can be driven again; the texts stand in its provenance
        self.constants = {
            **numbers(settings, self.Settings),
            'checkpoints_total': float(self._track.nbCheckpoint)}
        self.description = (f'pyRacerz, {settings.track} {settings.direction}, '
                            f'level {settings.level}')

    def reset(self, seed: int | None) -> Outcome:
        """Put the car to one of the game's starting places, or near it."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        # as many numbers for any track
        place, *rest = self._random.uniform(size=5)
        share = self._settings.start_variation
        self._player.play(self._track, 1 + int(3 * place * (share > 0)))
        self._vary_start(np.array(rest), share)
        self._column.angle = self._owed = self._turned = self._driven = 0.0
        self._frames = self._steps = self._lap_began = self._standing = 0
        self._checkpoints = self._most_checkpoints = self._laps = 0
        self._lap_steps = self._off_road = 0
        self._return = 0.0
        return Outcome(self._draw(), info=self._info())

    def advance(self, command: Command, frames: int = 1, *, draw: bool = True) -> Outcome:
        """Hold a command for up to some frames."""
        settings = self._settings
        start, reward = self._frames, 0.0
        while self._frames < start + frames and not any(self._ends()):
            for _ in range(settings.steps_per_frame):
                reward += self._step(command)
            self._frames += 1
            reward += FRAME_REWARD
        self._return += reward
        return Outcome(self._draw() if draw else None, reward, *self._ends(), info=self._info(),
                       frames=self._frames - start)

    def close(self) -> None:
        """Let go of what draws."""
        self._view.close()

    def _vary_start(self, shares: np.ndarray, variation: float) -> None:
        """Move the car from its place by some shares of what is allowed, at least on the map."""
        car = self._car
        along, across, turn, speed = (2 * shares - 1) * variation
        ahead = np.array([-math.cos(car.angle), -math.sin(car.angle)])
        side = np.array([-ahead[1], ahead[0]])
        car.x, car.y = (float(value) for value in (
            (car.x, car.y) + PLACE_JITTER * (along * ahead + across * side)))
        car.ox, car.oy = car.x, car.y
        car.angle = car.oldAngle = float(car.angle + turn * ANGLE_JITTER) % (2 * math.pi)
        car.speed = float(abs(speed) * SPEED_JITTER * car.maxSpeed)
        # the game compares it with the position in every step
        car.rect.topleft = (int(car.x - car.sizeRect / 2), int(car.y - car.sizeRect / 2))

    def _step(self, command: Command) -> float:
        """Let one step of the game pass; return the reward for checkpoints."""
        car = self._car
        if self._settings.driver == 'robot':
            self._press_keys()
        else:
            self._press_pedals(command.linear)
            car.angleW = self._wheel(command.angular)
        before = car.angle
        car.update()
        self._turned = (car.angle - before + math.pi) % (2 * math.pi) - math.pi
        self._driven += car.speed
        self._steps += 1
        moved = math.hypot(car.x - car.ox, car.y - car.oy)
        self._standing = self._standing + 1 if moved < STANDING else 0
        self._off_road += self._wheels_off_road() > 0.5
        return self._pass_checkpoint()

    def _press_keys(self) -> None:
        """Let the robot press its keys, and the keys move the pedals, as in the game's loop."""
        player, car = self._player, self._car
        player.compute()
        (car.doAccel if player.keyAccelPressed else car.noAccel)()
        (car.doBrake if player.keyBrakePressed else car.noBrake)()
        if player.keyLeftPressed:
            car.doLeft()
        if player.keyRightPressed:
            car.doRight()
        if not (player.keyLeftPressed or player.keyRightPressed):
            car.noWheel()

    def _press_pedals(self, linear: float) -> None:
        """Move the pedals to a command, as fast as the game's keys do."""
        car = self._car
        throttle, brake = max(linear, 0.0), max(-linear, 0.0)
        if not self._settings.reverse_gear and car.speed <= 0.0:
            brake = 0.0
        car.throttle = min(max(throttle, car.throttle - THROTTLE_FALL),
                           car.throttle + THROTTLE_RISE)
        car.brake = min(brake, car.brake + BRAKE_RISE)

    def _wheel(self, angular: float) -> float:
        """Return the game's steering, right positive, in [-1, 1]."""
        if self._settings.steering == 'direct':
            return -angular + 0.0
        self._column.turn(angular, STEP_SECONDS)
        # CarRacing's car turns by its wheels, the game's by its steering at whatever speed
        turning = -self._column.turning(self._car.speed / STEP_SECONDS / self._unit)
        wanted = turning * STEP_SECONDS * (1 - TURN_KEPT) / TURN_RISE
        if abs(wanted) >= LEAST_STEERING:
            self._owed = 0.0
            return min(max(wanted, -1.0), 1.0)
        # what turns too slowly for the game is owed, and paid by the smallest turn that there is
        self._owed += wanted * TURN_RISE / (1 - TURN_KEPT) - self._turned
        least = LEAST_STEERING * TURN_RISE
        return math.copysign(LEAST_STEERING, self._owed) if abs(self._owed) > least / 2 else 0.0

    def _pass_checkpoint(self) -> float:
        """Count checkpoints and laps by the game's rules; return the reward of a new one."""
        player, track = self._player, self._track
        red = track.trackF.get_at((int(self._car.x), int(self._car.y)))[0]
        last = RED_STEP * track.nbCheckpoint
        first, last, step = (last, RED_STEP, -RED_STEP) if track.reverse else (
            RED_STEP, last, RED_STEP)
        follows = red and red == player.lastCheckpoint + step
        if follows or (red == first and player.lastCheckpoint == last):
            self._checkpoints += 1
        elif red == first and player.lastCheckpoint != first:
            # a checkpoint was missed: the lap begins again
            self._checkpoints = 0
        else:
            return 0.0
        player.lastCheckpoint = red
        earned = 0.0
        # once a lap, however often it is begun
        if self._checkpoints > self._most_checkpoints:
            self._most_checkpoints = self._checkpoints
            earned = LAP_REWARD / track.nbCheckpoint
        if self._checkpoints == track.nbCheckpoint:
            self._laps += 1
            self._lap_steps = self._steps - self._lap_began
            self._checkpoints = self._most_checkpoints = 0
        if self._checkpoints == 0:
            self._lap_began = self._steps
        return earned

    def _ends(self) -> tuple[bool, bool]:
        return (self._laps >= self._settings.laps,
                self._frames >= self._settings.max_episode_frames)

    def _wheels_off_road(self) -> float:
        """Return the share of the car's corners that have not the grip of the road."""
        car, grip_at = self._car, self._track.trackF.get_at
        width, height = self._track.trackF.get_size()
        cosine, sine = math.cos(car.angle), math.sin(car.angle)
        off = 0
        for along, across in itertools.product((-car.height / 2, car.height / 2),
                                               (-car.width / 2, car.width / 2)):
            x = int(car.x + along * cosine + across * sine)
            y = int(car.y + along * sine - across * cosine)
            off += not (0 <= x < width and 0 <= y < height and grip_at((x, y))[1] == GRIP)
        return off / 4

    def _draw(self) -> np.ndarray:
        return self._view.draw(
            driven=self._driven, steering=self._column.angle,
            turning=-self._turned / STEP_SECONDS, score=self._return)

    def _info(self) -> Mapping[str, float]:
        car = self._car
        moved = math.hypot(car.x - car.ox, car.y - car.oy)
        return {
            'speed': moved / STEP_SECONDS,
            'wheels_off_road': self._wheels_off_road(),
            'off_road_seconds': self._off_road * STEP_SECONDS,
            'standing_still': self._standing // self._settings.steps_per_frame,
            'checkpoint': self._checkpoints,
            'laps_finished': self._laps,
            'lap_finished': self._laps >= self._settings.laps,
            'lap_seconds': self._lap_steps * STEP_SECONDS,
            'x': car.x,
            'y': car.y,
            # REP-103: from the x axis towards up
            'heading': math.remainder(math.pi - car.angle, 2 * math.pi),
            'throttle': car.throttle,
            'brake': car.brake,
            'steering': car.angleW,
        }
