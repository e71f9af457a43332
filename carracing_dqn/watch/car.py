# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One car as it is watched: its newest picture, and what belongs to it by stamp."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import dataclasses
import functools
import math
from typing import Any, NamedTuple

import numpy as np

from bags.cdr_time import first_time
from bags.decode import decode, decode_bundle
from carracing_dqn.simulation.profiles import find_profile, load_profile
from carracing_dqn.watch.evidence import Evidence
from carracing_dqn.watch.graph_parts import Node
from carracing_dqn.watch.series import SeriesTable
from msgs_bridge.errors import BridgeError
from msgs_bridge.images import compressed_to_array, image_to_array, MAX_BYTES
from msgs_bridge.named_values import read_named_values
from msgs_bridge.picture_parts import resized
from msgs_bridge.plain_text import plain
from msgs_bridge.step import (
    EPISODE_CORE, Q_VALUE_AXES, Q_VALUE_EXTRAS, read_step, VALIDATION_FIELDS,
)
from msgs_bridge.topics import CMD_VEL, COMPRESSED_TYPE, IMAGE, PLAIN_TWIST_TYPE, STEP
from msgs_bridge.twists import Command, read_command

IMAGE_TYPES = (IMAGE.type_name, COMPRESSED_TYPE)
TWIST_TYPES = (CMD_VEL.type_name, PLAIN_TWIST_TYPE)
BUNDLE_TYPE = STEP.type_name
ROLES = ('image_raw', 'step', 'q_values', 'cmd_vel', 'episode', 'validation')
"""What a car's topics are to it, by the names of the contract."""

# messages of a topic that are kept until the picture of their stamp has come
KEPT_MESSAGES = 200
KEPT_RESULTS = 100
# bytes of a bundle, a twist, a result; ours have 2 kB
MAX_SMALL_BYTES = 1 << 16
# weights this many versions apart may be on their way
STALE_VERSIONS = 2
# a picture is kept no larger than this
MOST_SIDE = 320
# actions of which the values are shown
MAX_ACTIONS = 64


class Message(NamedTuple):
    """A message as it came: its stamp in ns, its publisher's number, type and bytes."""

    stamp: int
    sequence: int
    type_name: str
    data: bytes


@dataclasses.dataclass
class Drive:
    """
    What is shown beside the picture, each None until it is known.

    Attributes:
        stamp: of the picture, ns.
        pixels: uint8 (H, W, 3) rgb, no side above `MOST_SIDE`.
        size: (width, height) of the image as it came.
        encoding: what the image says of itself.
        step: values by name of the `step` of that stamp, or of the newest.
        actions: name and value of each output of the network.
        chosen: index of the action, of one along two axes the nearest node of each; () where none
            is known.
        explored: whether it was drawn at random.
        version: of the weights.
        command: of the twist that answers the picture.
        episode: values of the newest `episode`.
        validation: values of the newest `validation`.
        ended: episodes that have ended since the watch began.
    """

    stamp: int | None = None
    pixels: np.ndarray | None = None
    size: tuple[int, int] | None = None
    encoding: str = ''
    step: dict[str, float] = dataclasses.field(default_factory=dict)
    actions: list[tuple[str, float]] = dataclasses.field(default_factory=list)
    chosen: tuple[int, ...] = ()
    explored: bool = False
    version: float | None = None
    command: Command | None = None
    episode: dict[str, float] = dataclasses.field(default_factory=dict)
    validation: dict[str, float] = dataclasses.field(default_factory=dict)
    ended: int = 0


class Car:
    """
    The topics of one namespace that belong together.

    Attributes:
        namespace: absolute, '' is the root.
        drive: what is shown of it.
        series: numbers of the last minutes.
        evidence: what `causes` judges by.
        rejected: messages that could not be used.
        number: of the picture, counted up with each new one.
        camera: what its camera is known to be like, as in `Profile.camera`.
        handed_out: version of the weights that the trainer has published, None where none is.
        weights_fresh_at: when the policy last drove with about those; seconds.
    """

    def __init__(self, namespace: str) -> None:
        """Begin with nothing."""
        self.namespace = namespace
        self.drive = Drive()
        self.series = SeriesTable()
        self.evidence = Evidence()
        self.rejected = 0
        self.number = 0
        self.camera: Mapping[str, Any] = {}
        self.weights_fresh_at = math.inf
        self.handed_out: float | None = None
        self._drives_with: float | None = None
        self._messages: dict[str, deque[Message]] = {
            role: deque(maxlen=KEPT_MESSAGES) for role in ('step', 'q_values', 'cmd_vel')}
        self._messages['image_raw'] = deque(maxlen=2)
        self._results: deque[tuple[str, Message]] = deque(maxlen=KEPT_RESULTS)
        self._seen: Message | None = None

    def take(self, role: str, message: Message) -> None:
        """Keep a message until the next look; what is too large or of another type is counted."""
        if role == 'image_raw':
            good = message.type_name in IMAGE_TYPES and len(message.data) <= MAX_BYTES
        else:
            types = TWIST_TYPES if role == 'cmd_vel' else (BUNDLE_TYPE,)
            good = message.type_name in types and len(message.data) <= MAX_SMALL_BYTES
        if not good:
            self.rejected += 1
        elif role in self._messages:
            self._messages[role].append(message)
        else:
            self._results.append((role, message))

    def hear(self, node: Node, now: float) -> None:
        """Take what a node of its namespace has said of itself."""
        base = node.name.rpartition('/')[2]
        self.series.add(now, {name: number for name in node.values
                              if (number := node.number(name)) is not None}, f'{base}.')
        if node.is_simulator:
            self.camera = _camera(node.values['simulator'])
            self.evidence.patch = self.camera.get('patch')
        if node.is_policy:
            self._drives_with = node.number('weights_version')
            self._compare_weights(now)

    def hand_out(self, version: float | None, now: float) -> None:
        """Note which version of the weights a trainer has handed out."""
        self.handed_out = version
        self._compare_weights(now)

    def _compare_weights(self, now: float) -> None:
        known = self.handed_out is not None and self._drives_with is not None
        if not known or abs(self.handed_out - self._drives_with) <= STALE_VERSIONS or (
                self.weights_fresh_at > now):
            self.weights_fresh_at = now

    def look(self, now: float) -> None:
        """Decode the newest picture and what has its stamp; `now` in s is when for the plots."""
        self._take_results(now)
        images = list(self._messages['image_raw'])
        if images and images[-1] is not self._seen:
            self._seen = images[-1]
            self._attempt(self._see, images)
        self._attempt(self._read_step, now)
        self._attempt(self._read_values, now)
        self._attempt(self._read_twist, images)

    def _attempt(self, act: Any, *arguments: Any) -> None:
        try:
            act(*arguments)
        except BridgeError:
            self.rejected += 1

    def _take_results(self, now: float) -> None:
        while self._results:
            self._attempt(self._take_result, *self._results.popleft(), now)

    def _take_result(self, role: str, message: Message, now: float) -> None:
        bundle = decode_bundle(message.data, role)
        drive = self.drive
        if role == 'validation':
            drive.validation = read_named_values(bundle, VALIDATION_FIELDS)
            self.series.add(now, {
                name: drive.validation[name] for name in ('mean', 'minimum', 'maximum')},
                'validation.')
            return
        drive.episode = read_named_values(bundle, EPISODE_CORE)
        if drive.episode['terminated'] or drive.episode['truncated']:
            drive.ended += 1
            self.series.add(now, {
                'return': drive.episode['episode_return'],
                'decisions': drive.episode['decisions']}, 'episode.')

    def _see(self, images: list[Message]) -> None:
        message = images[-1]
        pixels, encoding = _pixels(message)
        drive = self.drive
        drive.stamp, drive.encoding = message.stamp, encoding
        drive.size = pixels.shape[1::-1]
        drive.pixels = _no_larger(pixels)
        self.number += 1
        self.evidence.see_image(message.stamp, pixels, encoding, compressed=(
            message.type_name != IMAGE_TYPES[0]))
        before = images[0]
        if len(images) == 2 and message.sequence == before.sequence + 1:
            command = self._command_at(before.stamp)
            self.evidence.see_pair(
                message.stamp - before.stamp, _pixels(before)[0], pixels, command)

    def _read_step(self, now: float) -> None:
        message = self._at_stamp('step')
        if message is None:
            return
        values = read_named_values(decode_bundle(message.data, 'step'))
        step = read_step(values)
        self.drive.step = values
        self.series.add(now, values)
        if step.applied is not None and {'linear', 'angular'} <= step.info.keys():
            sent = self._command_at(step.applied)
            if sent is not None:
                self.evidence.see_applied(
                    step.applied, sent, Command(step.info['linear'], step.info['angular']))

    def _read_values(self, now: float) -> None:
        message = self._at_stamp('q_values')
        if message is None:
            return
        values = read_named_values(decode_bundle(message.data, 'q_values'), Q_VALUE_EXTRAS)
        drive = self.drive
        drive.actions = [(name, value) for name, value in values.items()
                         if name not in {**Q_VALUE_EXTRAS, **Q_VALUE_AXES}][:MAX_ACTIONS]
        most = max(len(drive.actions), 1)
        drive.chosen = tuple(
            int(values[name]) for name in ('chosen', 'chosen_second')
            if 0 <= values.get(name, -1) < most)
        drive.explored = values['explored'] > 0
        drive.version = values['weights_version']
        self.series.add(now, values, 'q.')

    def _read_twist(self, images: list[Message]) -> None:
        twists = self._messages['cmd_vel']
        if twists:
            at = self._command_at(images[-1].stamp) if images else None
            self.drive.command = at if at is not None else _command(twists[-1])

    def _at_stamp(self, role: str) -> Message | None:
        """Return the newest message of the picture's stamp, else the newest."""
        messages = self._messages[role]
        stamp = self.drive.stamp
        for message in reversed(messages):
            if message.stamp == stamp:
                return message
        return messages[-1] if messages else None

    def _command_at(self, stamp: int) -> Command | None:
        for message in reversed(self._messages['cmd_vel']):
            if message.stamp == stamp and message.type_name == TWIST_TYPES[0]:
                return _command(message)
        return None


def message_of(type_name: str, data: bytes, sequence: int = 0) -> Message:
    """Return a message with the stamp that it begins with, -1 if it is too short for one."""
    stamp = first_time(data)
    return Message(-1 if stamp is None else stamp, sequence, type_name, data)


# a name comes from another process: not every one may stay in memory
@functools.lru_cache(maxsize=32)
def _camera(simulator: str) -> Mapping[str, Any]:
    """Return what the camera of a simulator is known to be like."""
    # a name from another process chooses among the shipped profiles and no other files
    path = find_profile(simulator, shipped_only=True)
    try:
        return {} if path is None else load_profile(path).camera
    except BridgeError:
        return {}


def _command(message: Message) -> Command:
    twist = decode(message.data, message.type_name, 'cmd_vel')
    return read_command(twist.twist if message.type_name == TWIST_TYPES[0] else twist)


def _pixels(message: Message) -> tuple[np.ndarray, str]:
    image = decode(message.data, message.type_name, 'image')
    if message.type_name == IMAGE_TYPES[0]:
        return image_to_array(image), image.encoding
    return compressed_to_array(image), plain(image.format, 40)


def _no_larger(pixels: np.ndarray) -> np.ndarray:
    """Return a picture with no side above `MOST_SIDE`."""
    height, width, _ = pixels.shape
    part = MOST_SIDE / max(width, height)
    if part >= 1:
        return pixels
    size = max(1, round(width * part)), max(1, round(height * part))
    return resized(pixels, *size)
