# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that knows nothing of us: a camera in front, a plain Twist in m/s behind."""
import math

from geometry_msgs.msg import Twist
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image


class Robot(Node):
    """Drives on an endless floor with stripes, at 30 Hz."""

    def __init__(self):
        super().__init__('robot')
        self.x = self.yaw = self.speed = self.turn = 0.0
        self.images = self.create_publisher(Image, 'front/image', qos_profile_sensor_data)
        self.create_subscription(Twist, 'base/command', self.obey, 10)
        self.create_timer(1 / 30, self.move)

    def obey(self, twist):
        assert 0 <= twist.linear.x <= 0.8 and abs(twist.angular.z) <= 1.5
        self.speed, self.turn = twist.linear.x, twist.angular.z

    def move(self):
        self.yaw += self.turn / 30
        self.x += self.speed * math.cos(self.yaw) / 30
        shade = 100 + 50 * np.sin(np.arange(640) / 40 + 9 * self.yaw + self.x)
        image = Image(height=480, width=640, encoding='bgr8', step=1920)
        image.header.stamp = self.get_clock().now().to_msg()
        image.header.frame_id = 'front'
        image.data = np.broadcast_to(
            shade.astype(np.uint8)[None, :, None], (480, 640, 3)).tobytes()
        self.images.publish(image)


rclpy.init()
rclpy.spin(Robot())
