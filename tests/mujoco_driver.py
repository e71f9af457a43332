# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A driver of MuJoCo's car that knows the map: pure pursuit of the centre line."""
import math

from carracing_dqn.simulators import mujoco_world as world
from msgs_bridge.twists import Command
import numpy as np


def pursue(track, pose, speed, *, fastest=3.0, ahead=0.9):
    """Return the command towards the point of the line so far ahead, at a speed in m/s."""
    x, y, yaw = pose
    index = int(track.nearest(np.array([[x, y]]))[0][0])
    target = track.points[(index + round(ahead / track.spacing)) % len(track)]
    away = target - (x, y)
    left = away[1] * math.cos(yaw) - away[0] * math.sin(yaw)
    curvature = 2 * left / float(away @ away)
    steer = math.atan(world.WHEELBASE * curvature) / world.STEERING_LIMIT
    return Command(float(np.clip(0.8 * (fastest - speed), -1, 1)), float(np.clip(steer, -1, 1)))
