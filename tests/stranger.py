# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator of the test's own, driven by itself, in front of a real trainer."""
import dataclasses
import time

from geometry_msgs.msg import TwistStamped
from msgs_bridge import topics
from msgs_bridge.images import fill_image
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.stamps import set_stamp
from msgs_bridge.step import STEP_CORE
from msgs_bridge.twists import Command, fill_twist, STOP
import numpy as np
from sensor_msgs.msg import Image, JointState

DECISION = 80_000_000
SCALE = {'linear_scale': 2.0, 'angular_scale': -0.5}


class Stranger:
    """A simulator that publishes the core of `step` and nothing of ours, at its own size."""

    def __init__(self, graph):
        self.graph, self.stamp, self.number = graph, 10**9, 0
        self.image = self.step = self.twist = None

    def appear(self, space):
        """Publish what a car does, in a namespace below that of the graph."""
        self.image, self.step, self.twist = (
            self.graph.publisher(dataclasses.replace(topic, name=f'{space}/{topic.name}'))
            for topic in (topics.IMAGE, topics.STEP, topics.CMD_VEL))
        return self

    def frame(self, *, applied=None, command=STOP):
        """Publish what there are publishers for, once."""
        if self.image is not None:
            pixels = np.random.default_rng(self.number).integers(0, 256, (48, 64, 3), np.uint8)
            self.image.publish(fill_image(Image(), pixels, self.stamp, 'eye'))
        if self.step is not None:
            seconds, nanoseconds = divmod(
                self.stamp - DECISION if applied is None else applied, 10**9)
            self.step.publish(fill_named_values(JointState(), {
                **dict.fromkeys(STEP_CORE, 0.0), 'reward': 0.1, 'seed': -1.0,
                'decision': self.number, 'applied_sec': seconds if self.number else -1,
                'applied_nanosec': nanoseconds}, self.stamp))
        if self.twist is not None:
            message = TwistStamped()
            set_stamp(message.header.stamp, self.stamp)
            fill_twist(message.twist, Command(
                command.linear * SCALE['linear_scale'],
                command.angular * SCALE['angular_scale']))
            self.twist.publish(message)
        self.stamp += DECISION
        self.number += 1

    def drive_until(self, condition, seconds, what, **options):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, (
                f'{what} within {seconds} s; {self.graph.health("trainer_node")}; '
                f'{self.graph.last_words()}')
            self.frame(**options)
            self.graph.spin(0.02)
