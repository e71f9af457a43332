# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
mujoco_robot_node: MuJoCo's car as a robot, which says what robots say and knows no reward.

Publishes: `image_raw`, `odom` (nav_msgs/Odometry, by the physics, without drift), `collision`
(std_msgs/Bool), with `publish_path` also `path` (nav_msgs/Path), `/clock`, `/diagnostics`; no
`step` and no `episode`. Subscribes, services and behaviour when things go wrong:
`carracing_dqn/simulation/node.py`; `~/reset` puts the car on the start of the next track.
"""
from __future__ import annotations

from collections.abc import Sequence
import math
import sys

from carracing_dqn.simulation.drive import Frame
from carracing_dqn.simulation.node import SimulatorNode
from carracing_dqn.simulators.mujoco_car import MujocoRobot
from geometry_msgs.msg import PoseStamped
from msgs_bridge import topics
from msgs_bridge.errors import SettingsError
from msgs_bridge.node_shell import run_node
from msgs_bridge.stamps import set_stamp
from nav_msgs.msg import Odometry, Path
from rclpy.publisher import Publisher
from std_msgs.msg import Bool

# REP-105
WORLD_FRAME, CAR_FRAME = 'odom', 'base_link'


class MujocoRobotNode(SimulatorNode):
    """The car's node, with odometry and a bumper in place of a reward."""

    def __init__(self) -> None:
        """
        Declare the parameters, make the car and wait for a driver.

        Raises:
            SettingsError: a parameter that is unknown or not accepted.
            SimulatorError: MuJoCo cannot run here.
        """
        super().__init__('mujoco_robot_node', 'mujoco_robot')

    def open_outlets(self) -> Sequence[Publisher]:
        """Create the publishers of a robot."""
        if not isinstance(self.drive.simulator, MujocoRobot):
            raise SettingsError(f"simulator is {self.settings.simulator!r}; this node's is "
                                "'mujoco_robot'")
        self._odometry_publisher = self.publisher(topics.ODOMETRY)
        self._collision_publisher = self.publisher(topics.COLLISION)
        self._path_publisher = (
            self.publisher(topics.PATH) if self.settings.publish_path else None)
        return ()

    def send_frame(self, frame: Frame) -> None:
        """Publish a frame; what is known of it goes before its image, by which it is judged."""
        car = self.drive.simulator
        if frame.step.decision == 0 and self._path_publisher is not None:
            self._path_publisher.publish(self._path(frame.stamp))
        self._odometry_publisher.publish(_odometry(car, frame.stamp))
        self._collision_publisher.publish(Bool(data=frame.step.info['contact'] > 0))
        self.send_again(frame)
        self.send_clock(frame.stamp)

    def send_episode(self, values: dict[str, float], stamp: int) -> None:
        """Say nothing: a robot knows of no episodes."""

    def _path(self, stamp: int) -> Path:
        path = Path()
        set_stamp(path.header.stamp, stamp)
        path.header.frame_id = WORLD_FRAME
        for x, y in self.drive.simulator.track.points.tolist():
            pose = PoseStamped(header=path.header)
            pose.pose.position.x, pose.pose.position.y = x, y
            path.poses.append(pose)
        return path


def _odometry(car: MujocoRobot, stamp: int) -> Odometry:
    message = Odometry(child_frame_id=CAR_FRAME)
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = WORLD_FRAME
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, yaw = car.pose
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    twist.linear.x, twist.angular.z = car.motion
    return message


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(MujocoRobotNode, args)


if __name__ == '__main__':
    sys.exit(main())
