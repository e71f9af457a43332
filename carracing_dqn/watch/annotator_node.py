# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
image_annotator_node: what the car sees, with Q-values, action, reward, return and speed beside it.

Purpose: one picture for any viewer of images: RViz, rqt, Foxglove.

Subscribes, while somebody subscribes to its picture: `image_raw`, `step`, `q_values`, `cmd_vel`.
Publishes: `image_annotated`, `/diagnostics`. Parameters:
`carracing_dqn/watch/annotator_settings.py`.

Behaviour when things go wrong: without a subscriber it has no subscription and costs nobody
anything; a message that cannot be used is counted in the diagnostics. It never holds anybody
back: it takes the newest, best effort.
"""
from __future__ import annotations

import sys
import time

from bags.frames import RecordedFrame
from bags.painter import FramePainter
from carracing_dqn.watch.annotator_settings import AnnotatorSettings
from carracing_dqn.watch.car import Car, Drive, IMAGE_TYPES, message_of, TWIST_TYPES
from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge.images import fill_image
from msgs_bridge.matching import publishers_of
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import NodeShell, PolledGroup, run_node
from msgs_bridge.step import read_step, Step
from msgs_bridge.topics import CMD_VEL, IMAGE, IMAGE_ANNOTATED, Q_VALUES, STEP
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

# how often it is looked whether somebody wants the picture; seconds
LOOK_SECONDS = 0.5
# two images, so that Car sees how they follow each other; some of the others around them
DEPTHS = {IMAGE: 2, STEP: 30, Q_VALUES: 30, CMD_VEL: 30}
OTHER_TYPES = {IMAGE.name: IMAGE_TYPES, CMD_VEL.name: TWIST_TYPES}
MOST_SIDE = 1280
NO_STEP = Step(0.0, False, False, 0, 0, 0.0, -1, None, {})


class ImageAnnotatorNode(NodeShell):
    """Paints the newest frame for whoever subscribes."""

    def __init__(self) -> None:
        """Offer the picture; nothing is subscribed to before somebody wants it."""
        super().__init__('image_annotator_node', AnnotatorSettings)
        self._pictures = self.publisher(IMAGE_ANNOTATED)
        self._ears: dict[str, tuple[str, Subscription]] = {}
        self._car = Car('')
        self._painted = 0
        self._painter: tuple[tuple[int, int], FramePainter] | None = None
        self.create_timer(LOOK_SECONDS, self._follow)
        self.create_timer(1 / self.settings.rate, self._paint)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return whether somebody looks."""
        text = 'painting' if self._ears else 'nobody looks'
        return DiagnosticStatus.OK, text, {
            'pictures': self.counts['painted'], 'refused': self._car.rejected}

    def _follow(self) -> None:
        """Subscribe while somebody wants the picture, and to the types that are published."""
        wanted = {}
        if self._pictures.get_subscription_count():
            for topic in DEPTHS:
                name = self.resolve_topic_name(topic.name)
                types = {end.topic_type for end in publishers_of(self, name)}
                known = [one for one in OTHER_TYPES.get(topic.name, (topic.type_name,))
                         if one in types]
                if known:
                    wanted[topic.name] = known[0]
        for name, (type_name, ear) in list(self._ears.items()):
            if wanted.get(name) != type_name:
                self.destroy_subscription(ear)
                del self._ears[name]
        for topic, depth in DEPTHS.items():
            if topic.name in wanted and topic.name not in self._ears:
                self._ears[topic.name] = wanted[topic.name], self.create_subscription(
                    message_class(wanted[topic.name]), topic.name, lambda _: None,
                    QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT,
                               durability=DurabilityPolicy.VOLATILE),
                    raw=True, callback_group=PolledGroup())

    def _paint(self) -> None:
        if not self._ears:
            return
        for name, (type_name, ear) in self._ears.items():
            with ear.handle:
                for _ in range(max(DEPTHS.values())):
                    taken = ear.handle.take_message(ear.msg_type, True)
                    if taken is None:
                        break
                    self._car.take(name, message_of(
                        type_name, taken[0], taken[1]['publication_sequence_number'] or 0))
        self._car.look(time.monotonic())
        if self._car.number == self._painted:
            return
        self._painted = self._car.number
        drive = self._car.drive
        self.counts['painted'] += 1
        self._pictures.publish(fill_image(
            Image(), self._painter_of(drive).paint(
                RecordedFrame(0, drive.stamp, read_step(drive.step) if drive.step else NO_STEP,
                              drive.pixels, {}), _q_values(drive)),
            drive.stamp, ''))

    def _painter_of(self, drive: Drive) -> FramePainter:
        """Return the painter of pictures of this size."""
        height, width, _ = drive.pixels.shape
        if self._painter is None or self._painter[0] != (width, height):
            scale = max(1, min(self.settings.scale, MOST_SIDE // max(width, height)))
            self._painter = (width, height), FramePainter(width, height, scale)
        return self._painter[1]


def _q_values(drive: Drive) -> dict[str, float]:
    return {**dict(drive.actions), **dict(zip(('chosen', 'chosen_second'), drive.chosen))}


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(ImageAnnotatorNode, args)


if __name__ == '__main__':
    sys.exit(main())
