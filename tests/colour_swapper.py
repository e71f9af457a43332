# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A camera that exchanges red and blue and says nothing of it."""
import contextlib
import sys

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image


class Swapper(Node):
    """Republishes `true_colours` as `image_raw`."""

    def __init__(self):
        super().__init__('camera')
        self.images = self.create_publisher(Image, 'image_raw', 100)
        self.create_subscription(Image, 'true_colours', self.swap, 100)

    def swap(self, image):
        pixels = np.frombuffer(image.data, np.uint8).reshape(-1, 3)
        image.data = np.ascontiguousarray(pixels[:, ::-1]).tobytes()
        self.images.publish(image)


def main():
    """Run until stopped."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Swapper())
    return 0


if __name__ == '__main__':
    sys.exit(main())
