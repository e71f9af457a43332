# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The published frames of a bag: `step`, image and Q-values of one stamp together."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
import dataclasses
from typing import Any

import numpy as np

from bags.topic_lookup import find_topic, need_topic
from bags.decode import decode_bundle, decode_image
from bags.errors import BagError
from bags.reader import BagReader
from bags.steps import decode_step
from msgs_bridge.errors import MessageError
from msgs_bridge.step import Step
from msgs_bridge.topics import BURST_DEPTH, IMAGE, Q_VALUES, STEP
from msgs_bridge.transitions import MAX_IMAGE_BYTES, REACH


@dataclasses.dataclass(frozen=True)
class RecordedFrame:
    """
    One published frame of a bag.

    Attributes:
        number: of the `step` message in its topic, from 0.
        stamp: simulation time in ns.
        step: what the frame earned and what is known of it.
        pixels: uint8 (H, W, 3), or None if its image is not in the bag.
        q_values: name -> value of the decision that this frame led to; empty if not recorded.
    """

    number: int
    stamp: int
    step: Step
    pixels: np.ndarray | None
    q_values: dict[str, float]


def recorded_frames(
    reader: BagReader, *, namespace: str = '', with_q_values: bool = True,
    counts: Counter[str] | None = None,
) -> Iterator[RecordedFrame]:
    """
    Yield the published frames of a bag in the order of their steps.

    As where transitions are joined, a message that cannot be used is passed over, and a step
    alone does not move time far ahead or back: it takes two that follow each other, as when a
    simulator is started again.

    Args:
        reader: the bag.
        namespace: where the topics of the car are; needed if there are several.
        with_q_values: whether they are read, too.
        counts: follows how many messages were `rejected`, as they cannot be used.

    Raises:
        BagError: a damaged bag, or one without images or steps.
    """
    steps = need_topic(reader, STEP, namespace=namespace)
    images = need_topic(reader, IMAGE, namespace=namespace)
    q_values = find_topic(reader, Q_VALUES, namespace=namespace) if with_q_values else None
    image_type = reader.topics[images].type_name
    counts = Counter() if counts is None else counts
    gathering = _Gathering(with_q_values=q_values is not None)
    number = -1
    for message in reader.messages(list(filter(None, (steps, images, q_values)))):
        number += message.topic == steps
        try:
            if message.topic == steps:
                found = gathering.add_step(number, *decode_step(message.data, steps))
            elif message.topic == images:
                found = gathering.add(
                    gathering.images, *decode_image(message.data, images, image_type))
            else:
                bundle = decode_bundle(message.data, message.topic)
                found = gathering.add(gathering.q_values, bundle.stamp, bundle.values_with())
        except (BagError, MessageError):
            counts['rejected'] += 1
            continue
        yield from found
    yield from gathering.rest()


class _Lane:
    """
    Values of one topic that no step has taken yet.

    Attributes:
        values: by stamp, in the order they came.
        reached: number of the newest step of which the value came: what belongs to those before
            will not come any more.
    """

    def __init__(self) -> None:
        self.values: dict[int, Any] = {}
        self.reached = -1
        self._bytes = 0

    @property
    def full(self) -> bool:
        """Return whether more is held than one topic is behind another."""
        return len(self.values) > BURST_DEPTH or self._bytes > MAX_IMAGE_BYTES

    def put(self, stamp: int, value: Any) -> None:
        """Hold a value, in place of one of the same stamp."""
        self.take(stamp)
        self.values[stamp] = value
        self._bytes += getattr(value, 'nbytes', 0)

    def take(self, stamp: int) -> Any:
        """Return the value of a stamp, or None, and hold it no longer."""
        value = self.values.pop(stamp, None)
        self._bytes -= getattr(value, 'nbytes', 0)
        return value

    def forget(self, which: Callable[[int], bool]) -> None:
        """Drop the values of some stamps."""
        for stamp in list(filter(which, self.values)):
            self.take(stamp)


class _Gathering:
    """Brings together what has one stamp, out of topics each of which is in order by itself."""

    def __init__(self, *, with_q_values: bool) -> None:
        self.images, self.q_values = _Lane(), _Lane()
        self._lanes = [self.images, self.q_values] if with_q_values else [self.images]
        # the steps that are believed and lack something, by stamp
        self._waiting: dict[int, tuple[int, Step]] = {}
        self._newest: int | None = None
        self._doubted: tuple[int, int, Step] | None = None

    def add(self, lane: _Lane, stamp: int, value: Any) -> list[RecordedFrame]:
        """Take an image or Q-values; return the frames that wait for nothing more."""
        lane.put(stamp, value)
        if stamp in self._waiting:
            lane.reached = self._waiting[stamp][0]
        return self._complete()

    def add_step(self, number: int, stamp: int, step: Step) -> list[RecordedFrame]:
        """Take the step of a number; return the frames that wait for nothing more."""
        if stamp == self._newest:
            return []
        doubted, self._doubted = self._doubted, None
        found = []
        if self._newest is not None and not _follows(stamp, self._newest):
            if doubted is None or not _follows(stamp, doubted[1]):
                self._doubted = number, stamp, step
                return []
            if stamp < self._newest:
                found = self._rewind(self._newest)
            self._expect(*doubted)
        self._expect(number, stamp, step)
        return found + self._complete()

    def rest(self) -> list[RecordedFrame]:
        """Return the frames of which nothing more will come."""
        return [self._frame(stamp) for stamp in list(self._waiting)]

    def _rewind(self, newest: int) -> list[RecordedFrame]:
        """Go back in time: what is of the newest stamp before, or later, belongs to no step."""
        found = self.rest()
        for lane in self._lanes:
            lane.forget(lambda stamp: stamp >= newest)
        return found

    def _expect(self, number: int, stamp: int, step: Step) -> None:
        self._newest = stamp
        self._waiting[stamp] = number, step
        for lane in self._lanes:
            if stamp in lane.values:
                lane.reached = number

    def _complete(self) -> list[RecordedFrame]:
        found = []
        while self._waiting:
            stamp, (number, _) = next(iter(self._waiting.items()))
            if not self._crowded() and any(
                    stamp not in lane.values and lane.reached < number for lane in self._lanes):
                break
            found.append(self._frame(stamp))
            for lane in self._lanes:
                lane.forget(lambda other, stamp=stamp: other < stamp)
        for lane in self._lanes:
            while lane.full and not self._waiting:
                lane.take(next(iter(lane.values)))
        return found

    def _crowded(self) -> bool:
        return len(self._waiting) > BURST_DEPTH or any(lane.full for lane in self._lanes)

    def _frame(self, stamp: int) -> RecordedFrame:
        number, step = self._waiting.pop(stamp)
        return RecordedFrame(
            number, stamp, step, self.images.take(stamp), self.q_values.take(stamp) or {})


def _follows(stamp: int, other: int) -> bool:
    return 0 < stamp - other <= REACH
