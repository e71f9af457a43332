# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A small car with real contact physics on tracks of seeds, by MuJoCo."""
from __future__ import annotations

import dataclasses
import math
import os

from carracing_dqn.simulators import mujoco_world as world
from carracing_dqn.simulators.mujoco_picture import load_mujoco, Pictures
from msgs_bridge.settings import numbers, setting
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.twists import Command
import numpy as np

TOP, BONNET = 'top', 'bonnet'
# from above: how far ahead of the car the camera looks, and from how high, m
TOP_AHEAD, TOP_HEIGHT = 1.5, 6.4
FRAME_STEPS = 10
LAP_REWARD, FRAME_PENALTY, FIELD_PENALTY = 1000.0, 0.1, 100.0
# of the tiles must have been visited when the car has come round
LAP_SHARE = 0.95
# a wheel reaches so far beside the middle of the car, m
REACH = world.TREAD / 2 + world.WHEEL_HALF_WIDTH
# tiles that may be passed in one frame; who gets farther has cut across the grass
MOST_TILES = 4
# cosine of the angle from upright at which the car has tipped over
TIPPED = 0.3


@dataclasses.dataclass(frozen=True)
class MujocoCarSettings:
    """What can be set on MuJoCo's car."""

    camera: str = setting(
        TOP, 'top: from above, ahead of the car is up; bonnet: what a camera on it sees',
        choices=(TOP, BONNET))
    picture_width: int = setting(96, 'columns of a frame', low=8, high=1024)
    picture_height: int = setting(96, 'rows of a frame', low=8, high=1024)
    max_episode_frames: int = setting(
        1000, 'frames of 50 ms after which an episode is truncated', low=1, high=10**6)
    early_end_frames: int = setting(
        0, 'variant, for training: truncate after this many frames without a new tile; 0 = never',
        low=0, high=10**6)
    frame_id: str = setting('camera', 'frame_id of the images')


class MujocoCar(Simulator):
    """
    Four wheels on the ground, the front ones steered, the rear ones driven.

    linear is the torque of the rear wheels: against the way it goes it brakes, then it drives
    back. angular turns the front wheels.
    """

    Settings = MujocoCarSettings
    rules = True
    frame_seconds = FRAME_STEPS * world.STEP_SECONDS
    deterministic = True

    def __init__(self, settings: MujocoCarSettings) -> None:
        """
        Load MuJoCo and see that it can draw.

        Raises:
            SimulatorError: MuJoCo or a library is missing; the line says how to install it.
        """
        self._mujoco = load_mujoco()
        self.description = (f'MuJoCo {self._mujoco.__version__}, {settings.camera} camera, '
                            f'MUJOCO_GL={os.environ.get("MUJOCO_GL", "")}')
        self._settings = settings
        # by these a bag can be driven again
        self.constants = numbers(settings, self.Settings)
        self._random = np.random.default_rng()
        self._pictures = Pictures(
            self._mujoco, settings.picture_width, settings.picture_height)

    @property
    def pose(self) -> tuple[float, float, float]:
        """Return where the car is and where it heads: x and y in m, yaw in rad."""
        x_axis = self._hull.xmat[0::3]
        return (float(self._hull.xpos[0]), float(self._hull.xpos[1]),
                math.atan2(x_axis[1], x_axis[0]))

    @property
    def motion(self) -> tuple[float, float]:
        """Return how fast it goes ahead and turns left: m/s and rad/s."""
        _, _, yaw = self.pose
        velocity = self._data.qvel
        return (float(velocity[0] * math.cos(yaw) + velocity[1] * math.sin(yaw)),
                float(velocity[5]))

    def reset(self, seed: int | None) -> Outcome:
        """Put the car on the start of a new track, at rest."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        self._build(world.make_track(self._random))
        self._visited = np.zeros(len(self.track), bool)
        self._position = self._frame = self._waited = 0
        self._contact = False
        # onto the ground
        for _ in range(FRAME_STEPS):
            self._mujoco.mj_step(self._model, self._data)
        self._visit()
        return Outcome(self._pixels(), info=self._info())

    def advance(self, command: Command, frames: int = 1) -> Outcome:
        """Hold a command for some frames; only the last is drawn."""
        data, model, mj_step = self._data, self._model, self._mujoco.mj_step
        data.ctrl[:2] = world.steering_angles(command.angular)
        data.ctrl[2:] = command.linear
        self._contact = False
        reward, passed = 0.0, 0
        terminated = truncated = False
        while passed < frames and not (terminated or truncated):
            for _ in range(FRAME_STEPS):
                mj_step(model, data)
                self._contact = self._contact or self._touches_wall()
            passed += 1
            self._frame += 1
            earned = self._visit()
            self._waited = 0 if earned else self._waited + 1
            if self.rules:
                failed = self._left_field or self._tipped
                reward += earned - FRAME_PENALTY - failed * FIELD_PENALTY
                terminated = failed or self._lap_finished
                truncated = not terminated and (
                    self._ended_early or self._frame >= self._settings.max_episode_frames)
        return Outcome(self._pixels(), reward, terminated, truncated, self._info(), passed)

    def skip(self, episodes: int, seed: int | None) -> None:
        """Draw tracks without building them."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        for _ in range(episodes):
            world.make_track(self._random)

    def close(self) -> None:
        """Let go of the picture's memory."""
        self._pictures.close()

    def _build(self, track: world.Track) -> None:
        mujoco, settings = self._mujoco, self._settings
        self.track = track
        side = max(settings.picture_width, settings.picture_height)
        self._model = mujoco.MjModel.from_xml_string(world.world_xml(track, side))
        self._data = mujoco.MjData(self._model)
        self._hull = self._data.body('car')
        self._wheels = [self._data.body(name) for name in world.WHEELS]
        self._wheel_joints = [self._model.joint(name).dofadr[0] for name in world.WHEELS]
        walls = [number for number in range(self._model.ngeom)
                 if self._model.geom(number).name.startswith(world.WALL_PREFIX)]
        self._walls = (min(walls), max(walls)) if walls else (0, -1)
        self._pictures.show(self._model)
        self._camera = mujoco.MjvCamera()
        if settings.camera == TOP:
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
            self._camera.elevation, self._camera.distance = -90.0, TOP_HEIGHT
        else:
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self._camera.fixedcamid = self._model.camera(BONNET).id

    def _visit(self) -> float:
        """Look where the car is now and return what new tiles earn."""
        track, count = self.track, len(self.track)
        x, y, yaw = self.pose
        places = np.array([(x, y), *(wheel.xpos[:2] for wheel in self._wheels)])
        indices, offsets = track.nearest(places)
        index, self._offset = int(indices[0]), float(offsets[0])
        self._heading_error = math.remainder(yaw - track.headings[index], 2 * math.pi)
        moved = (index - self._position + count // 2) % count - count // 2
        earned = 0.0
        if abs(self._offset) <= world.HALF_WIDTH + REACH:
            first = self._position + 1 if 0 < moved <= MOST_TILES else self._position + moved
            passed = np.arange(first, self._position + moved + 1) % count
            earned = LAP_REWARD / count * int((~self._visited[passed]).sum())
            self._visited[passed] = True
        self._position += moved
        on_grass = np.abs(offsets[1:]) > world.HALF_WIDTH
        self._off_road = float(on_grass.mean())
        self._model.dof_damping[self._wheel_joints] = np.where(
            on_grass, world.GRASS_RESISTANCE, world.ROAD_RESISTANCE)
        return earned

    @property
    def _tipped(self) -> bool:
        return bool(self._hull.xmat[8] < TIPPED)

    @property
    def _left_field(self) -> bool:
        return abs(self._offset) > world.FIELD

    @property
    def _lap_finished(self) -> bool:
        count = len(self.track)
        return self._position >= count and self._visited.sum() >= LAP_SHARE * count

    @property
    def _ended_early(self) -> bool:
        return 0 < self._settings.early_end_frames <= self._waited

    def _touches_wall(self) -> bool:
        first, last = self._walls
        geoms = self._data.contact.geom
        return bool(((geoms >= first) & (geoms <= last)).any())

    def _pixels(self) -> np.ndarray:
        if self._settings.camera == TOP:
            x, y, yaw = self.pose
            self._camera.azimuth = math.degrees(yaw)
            self._camera.lookat[:] = (
                x + TOP_AHEAD * math.cos(yaw), y + TOP_AHEAD * math.sin(yaw), 0.0)
        return self._pictures.draw(self._model, self._data, self._camera)

    def _info(self) -> dict[str, float]:
        return {
            # m/s ahead
            'speed': self.motion[0],
            # m to the left of the centre line; rad to the left of its heading
            'lane_offset': self._offset, 'heading_error': self._heading_error,
            # share of the wheels on the grass
            'wheels_off_road': self._off_road, 'off_road': float(self._off_road == 1.0),
            'progress': float(self._visited.mean()), 'lap_position': float(self._position),
            'tiles_visited': float(self._visited.sum()), 'tiles_total': float(len(self.track)),
            'lap_finished': float(self._lap_finished), 'left_field': float(self._left_field),
            # the variant early_end_frames ended it
            'ended_early': float(self._ended_early),
            # touched a wall since the frame before
            'contact': float(self._contact)}


@dataclasses.dataclass(frozen=True)
class MujocoRobotSettings(MujocoCarSettings):
    """What can be set on MuJoCo's car as a robot."""

    publish_path: bool = setting(
        False, 'true: the node publishes the centre line on path, as the planner of a robot '
        'with a map would')


class MujocoRobot(MujocoCar):
    """The car as a robot, which knows no reward and no end: a referee says both."""

    Settings = MujocoRobotSettings
    rules = False
