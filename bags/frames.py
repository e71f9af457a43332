# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The published frames of a bag: `step`, image and Q-values of one stamp together."""
from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from typing import Any

import numpy as np

from bags.topic_lookup import find_topic, need_topic
from bags.decode import decode_bundle, decode_image
from bags.reader import BagReader
from bags.steps import decode_step
from msgs_bridge.errors import MessageError
from msgs_bridge.step import Step
from msgs_bridge.topics import IMAGE, Q_VALUES, STEP


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


def recorded_frames(reader: BagReader, *, namespace: str = '') -> Iterator[RecordedFrame]:
    """
    Yield the published frames of a bag in order of their stamps.

    Raises:
        BagError: a damaged bag, or one without images or steps.
        MessageError: a message that cannot be used, or time that goes back.
    """
    steps = need_topic(reader, STEP, namespace=namespace)
    images = _images(reader, need_topic(reader, IMAGE, namespace=namespace))
    q_values = _q_values(reader, find_topic(reader, Q_VALUES, namespace=namespace))
    newest = -1
    for number, message in enumerate(reader.messages([steps])):
        stamp, step = decode_step(message.data, steps)
        if stamp == newest:
            continue
        if stamp < newest:
            raise MessageError(f'{steps}: message {number} goes back in time')
        newest = stamp
        yield RecordedFrame(
            number, newest, step, images.at(newest), q_values.at(newest) or {})


class _Stream:
    """Values of a topic by stamp, asked for in order of time."""

    def __init__(self, values: Iterator[tuple[int, Any]]) -> None:
        self._values = values
        self._next: tuple[int, Any] | None = None

    def at(self, stamp: int) -> Any:
        """Return the value of a stamp, or None; older ones are passed over."""
        while self._next is None or self._next[0] < stamp:
            self._next = next(self._values, None)
            if self._next is None:
                return None
        return self._next[1] if self._next[0] == stamp else None


def _images(reader: BagReader, name: str) -> _Stream:
    type_name = reader.topics[name].type_name
    return _Stream(decode_image(message.data, name, type_name)
                   for message in reader.messages([name]))


def _q_values(reader: BagReader, name: str | None) -> _Stream:
    def values() -> Iterator[tuple[int, dict[str, float]]]:
        for message in reader.messages([name]) if name else ():
            bundle = decode_bundle(message.data, name)
            yield bundle.stamp, bundle.values_with()
    return _Stream(values())
