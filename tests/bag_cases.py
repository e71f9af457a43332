# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Bags for tests: real drives of the environment recorded without ROS, and small ones."""
from collections.abc import Callable
import json
from pathlib import Path

from bags.decode import typestore
from bags.qos_text import offered_qos
from bags.writer import BagWriter
from carracing_dqn.simulation import open_drive
from msgs_bridge.topics import CLOCK, CMD_VEL, EPISODE, IMAGE, Q_VALUES, REWARD, STEP
from msgs_bridge.twists import Command
import numpy as np

TYPES = typestore()
MILLISECOND = 1_000_000
EMPTY = np.zeros(0)


def message(topic, *fields) -> bytes:
    return serialized(topic.type_name, *fields)


def serialized(type_name: str, *fields) -> bytes:
    return bytes(TYPES.serialize_cdr(TYPES.types[type_name](*fields), type_name))


def stamp_of(nanoseconds: int):
    return TYPES.types['builtin_interfaces/msg/Time'](*divmod(nanoseconds, 10 ** 9))


def header(nanoseconds: int, frame_id: str = 'car'):
    return TYPES.types['std_msgs/msg/Header'](stamp_of(nanoseconds), frame_id)


def image(nanoseconds: int, pixels: np.ndarray) -> bytes:
    height, width, _ = pixels.shape
    return message(IMAGE, header(nanoseconds), height, width, 'rgb8', 0, 3 * width,
                   np.ascontiguousarray(pixels).reshape(-1))


def bundle(nanoseconds: int, values: dict[str, float]) -> bytes:
    return message(STEP, header(nanoseconds), list(values),
                   np.array(list(map(float, values.values()))), EMPTY, EMPTY)


def twist(nanoseconds: int, command: Command) -> bytes:
    vector, kind = (TYPES.types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Twist'))
    return message(CMD_VEL, header(nanoseconds), kind(
        vector(command.linear, 0.0, 0.0), vector(0.0, 0.0, command.angular)))


def clock(nanoseconds: int) -> bytes:
    return message(CLOCK, stamp_of(nanoseconds))


def scripted(decision: int) -> Command:
    """Drive off the grass now and then, so that rewards and flags vary."""
    return Command(0.4 if decision % 3 else 0.0, -0.3 * np.sin(decision / 7.0))


class DriveRecorder:
    """Records a drive as the graph would, with the topics in a namespace."""

    def __init__(self, folder: Path, *, namespace: str = '', provenance: dict | None = None,
                 falsify: Callable[[dict], dict] = dict, **options: object) -> None:
        self.falsify = falsify
        data = {key: value if isinstance(value, str) else json.dumps(value)
                for key, value in (provenance or {}).items()}
        self.writer = BagWriter(folder, custom_data=data, **options)
        self.topics = {
            topic.name: self.writer.add_topic(
                topic.name if topic.name.startswith('/') else f'{namespace}/{topic.name}',
                topic.type_name, [offered_qos(reliable=topic.reliable, latched=topic.latched)])
            for topic in (IMAGE, STEP, REWARD, EPISODE, CMD_VEL, Q_VALUES, CLOCK)}
        self.time = 1_700_000_000 * 10 ** 9

    def put(self, topic, data: bytes) -> None:
        self.time += MILLISECOND
        self.writer.write(self.topics[topic.name], self.time, self.time - 1000, data)

    def frame(self, frame) -> None:
        self.put(CLOCK, clock(frame.stamp))
        self.put(STEP, bundle(frame.stamp, self.falsify(frame.step.values())))
        self.put(REWARD, message(REWARD, frame.step.reward))
        if frame.episode is not None:
            self.put(EPISODE, bundle(frame.stamp, frame.episode))
        self.put(IMAGE, image(frame.stamp, frame.pixels))


def record_drive(
    folder: Path,
    *,
    episodes: int = 2,
    decisions: int = 40,
    skip_first: int = 0,
    change: Callable = lambda frame: frame,
    drive_with: Callable = scripted,
    namespace: str = '',
    settings: dict | None = None,
    named: bool = True,
    **options: object,
) -> Path:
    """
    Record some episodes; `change` may falsify a frame, `drive_with` gives the applied actions.

    `falsify` may be given to change the values of a `step`, to such as no simulator has.

    The first `skip_first` frames are driven but not recorded. Without `named` the bag says nothing
    of how its simulator was set.
    """
    values = {'seed': 5, 'seed_each_episode': True, 'max_episode_frames': decisions,
              **(settings or {})}
    if 'simulator' in values:
        # a setting of CarRacing
        del values['max_episode_frames']
    drive = open_drive(values)
    recorder = DriveRecorder(
        folder, namespace=namespace, provenance={'simulator': values} if named else None,
        **options)
    number = 0
    for _ in range(episodes):
        frame = drive.begin()
        while True:
            if number >= skip_first:
                recorder.frame(change(frame))
            number += 1
            if frame.step.ended:
                break
            command = drive_with(drive.decision)
            # a twist carries 64-bit numbers, so the simulator gets exactly these
            if number > skip_first:
                recorder.put(CMD_VEL, twist(frame.stamp, command))
                recorder.put(Q_VALUES, bundle(frame.stamp, {
                    'left': 0.5, 'right': 1.5, 'chosen': 1, 'explored': 0,
                    'weights_version': 3}))
            frame = drive.advance(command, frame.stamp)
    recorder.writer.close()
    return folder


def small_bag(folder: Path, *, messages: int = 200, chunk_bytes: int = 2048,
              **options: object) -> list[tuple[str, int, int, bytes]]:
    """Write a bag of clocks and rewards in several chunks; return what is in it."""
    written = []
    with BagWriter(folder, chunk_bytes=chunk_bytes, **options) as writer:
        numbers = {}
        for topic in (CLOCK, REWARD):
            numbers['/' + topic.name.lstrip('/')] = writer.add_topic(
                '/' + topic.name.lstrip('/'), topic.type_name, [offered_qos()])
        for number in range(messages):
            for name, data in (('/clock', clock(number)),
                               ('/reward', message(REWARD, float(number)))):
                written.append((name, 1000 + 10 * number, 999 + 10 * number, data))
                writer.write(numbers[name], *written[-1][1:])
    return written


def read_all(reader) -> list[tuple[str, int, int, bytes]]:
    return [(one.topic, one.log_time, one.publish_time, bytes(one.data))
            for one in reader.messages()]
