# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A camera and who hears it, each a process of plain rclpy: what a transport is measured with."""
from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image

DEPTH = 10
START_SECONDS = 60.0
# what is still under way after the last image
LATE_SECONDS = 2.0


def publish(shape: tuple[int, int], rate: float, count: int, reliability: str,
            readers: int) -> None:
    """Publish images of (height, width) once so many readers are there."""
    rclpy.init()
    node = rclpy.create_node('camera')
    publisher = node.create_publisher(Image, 'image', QoSProfile(
        depth=DEPTH, reliability=QoSReliabilityPolicy[reliability.upper()]))
    height, width = shape
    message = Image(height=height, width=width, encoding='rgb8', step=3 * width)
    message.data = bytes(3 * width * height)
    until = time.monotonic() + START_SECONDS
    while publisher.get_subscription_count() < readers and time.monotonic() < until:
        time.sleep(0.05)
    due = time.monotonic()
    for _ in range(count):
        due += 1 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
    # an ending writer takes along what nobody has asked for again yet
    time.sleep(LATE_SECONDS)
    rclpy.try_shutdown()


def hear(seconds: float, reliability: str, ages: Any) -> None:
    """Send the ages in seconds of the images that came within some seconds after the first."""
    rclpy.init()
    node = rclpy.create_node('listener')
    heard: list[float] = []

    def take(message: Image) -> None:
        stamp = message.header.stamp
        heard.append(time.time() - stamp.sec - 1e-9 * stamp.nanosec)

    node.create_subscription(Image, 'image', take, QoSProfile(
        depth=DEPTH, reliability=QoSReliabilityPolicy[reliability.upper()]))
    until = time.monotonic() + START_SECONDS
    began = False
    while time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.1)
        if heard and not began:
            began, until = True, time.monotonic() + seconds + LATE_SECONDS
    ages.send(heard)
    rclpy.try_shutdown()
