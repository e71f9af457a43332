# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
How fast bags are read, written and played, beside `mcap` and `rosbags` in the same run.

The bag is made of frames of the real environment, with the topics of one decision: an image and
five small messages. Reading is measured with the file in the page cache.
"""
from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
import contextlib
import json
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

import numpy as np

from bags.compression import COMPRESSIONS
from bags.decode import typestore
from bags.image_arrays import load_images
from bags.playback import Playback
from bags.qos_text import offered_qos
from bags.read_ahead import ReadAhead
from bags.reader import BagReader
from bags.schemas import schema_of
from bags.writer import BagWriter
from msgs_bridge.step import STEP_CORE, STEP_INFO
from msgs_bridge.topics import CLOCK, CMD_VEL, IMAGE, Q_VALUES, REWARD, STEP

DECISIONS = 6000
REPEATS = 3
FRAME_NS = 20_000_000
# pace of the playback measurement: that of a fast lockstep run
PLAY_PERIOD_NS = 2_000_000
PLAY_SECONDS = 6.0
TOPICS = (IMAGE, STEP, REWARD, CMD_VEL, Q_VALUES, CLOCK)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; return 0."""
    parser = argparse.ArgumentParser(prog='bench_bags', description=__doc__)
    parser.add_argument('--decisions', type=int, default=DECISIONS,
                        help=f'decisions in the bag (default {DECISIONS})')
    parser.add_argument('--recorder', action='store_true',
                        help='measure what the recorder takes off a lockstep run, too')
    parser.add_argument('--json', metavar='FILE', help='write the figures there too')
    options = parser.parse_args(arguments)
    figures: dict[str, Any] = {'decisions': options.decisions, 'write': {}, 'read': {}}
    messages = make_messages(options.decisions)
    with tempfile.TemporaryDirectory() as folder:
        for compression in COMPRESSIONS:
            path = Path(folder, compression)
            write_figures = bench_write(messages, path, compression)
            figures['write'][compression] = write_figures
            figures['read'][compression] = bench_read(path)
            show_read(compression, write_figures, figures['read'][compression])
        figures['play'] = bench_play(Path(folder, 'lz4'), PLAY_PERIOD_NS / FRAME_NS)
        show(f'playback at {1e9 / PLAY_PERIOD_NS:.0f} decisions/s: timing error '
             f'p50 {figures["play"]["p50_ms"]:.3f} ms, p99 {figures["play"]["p99_ms"]:.3f} ms')
        if options.recorder:
            from carracing_dqn.benchmarks.listener_cost import recorder_cost
            cost = figures['recorder'] = recorder_cost(Path(folder))
            show(f'lockstep with the recorder {cost["decisions_per_second_with"]:.0f} '
                 f'decisions/s, without {cost["decisions_per_second_without"]:.0f}: it takes '
                 f'{cost["cost_percent"]:.1f} ± {cost["cost_percent_error"]:.1f} %, '
                 f'{cost["cpu_percent"]:.1f} % of a core, '
                 f'{cost["steps_missing"]} steps missing')
    if options.json:
        Path(options.json).write_text(json.dumps(figures, indent=2) + '\n', encoding='utf-8')
    return 0


def make_messages(decisions: int) -> list[list[bytes]]:
    """Return the serialized messages of each decision, in the order of TOPICS."""
    from carracing_sim_node import info_fields, make_env
    types = typestore()
    names = {topic: types.types[topic.type_name] for topic in TOPICS}
    time_type, header_type = (types.types[name] for name in (
        'builtin_interfaces/msg/Time', 'std_msgs/msg/Header'))
    vector, twist = (types.types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Twist'))
    empty = np.zeros(0)
    env = make_env()
    frame, _ = env.reset(seed=42)
    result = []
    for number in range(decisions):
        stamp = time_type(*divmod(number * FRAME_NS, 10 ** 9))
        header = header_type(stamp, 'car_top_down')
        facts = [*STEP_CORE, *STEP_INFO, *info_fields.STEP_INFO]
        decision = (
            names[IMAGE](header, 96, 96, 'rgb8', 0, 288, frame.reshape(-1)),
            names[STEP](header, facts, np.full(len(facts), float(number)), empty, empty),
            names[REWARD](-0.1),
            names[CMD_VEL](header, twist(vector(0.5, 0, 0), vector(0, 0, 0.1))),
            names[Q_VALUES](header, [f'action {k}' for k in range(8)], np.ones(8), empty, empty),
            names[CLOCK](stamp))
        result.append([
            bytes(types.serialize_cdr(message, topic.type_name))
            for topic, message in zip(TOPICS, decision)])
        frame, _, terminated, truncated, _ = env.step((0.1, 0.3 if number % 3 else 0.0, 0.0))
        if terminated or truncated:
            frame, _ = env.reset()
    return result


def bench_write(messages: list[list[bytes]], path: Path, compression: str) -> dict[str, float]:
    """Write the bag; return messages/s of ours and of the mcap library's writer."""
    count = len(messages) * len(TOPICS)
    began, cpu = time.perf_counter(), time.process_time()
    with BagWriter(path, compression=compression) as writer:
        topics = [writer.add_topic(f'/{topic.name.lstrip("/")}', topic.type_name, [offered_qos()])
                  for topic in TOPICS]
        for number, decision in enumerate(messages):
            for topic, data in zip(topics, decision):
                writer.write(topic, number * FRAME_NS, number * FRAME_NS, data)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    size = sum(file.stat().st_size for file in path.iterdir())
    return {
        'messages_per_second': count / seconds, 'cpu_us_per_message': 1e6 * cpu / count,
        'megabytes': size / 1e6,
        'mcap_messages_per_second': count / write_with_mcap(messages, path, compression)}


def write_with_mcap(messages: list[list[bytes]], path: Path, compression: str) -> float:
    """Write the same with the mcap library; return seconds."""
    from mcap.writer import CompressionType, Writer
    target = path.with_name(f'{path.name}.reference.mcap')
    began = time.perf_counter()
    with target.open('wb') as file:
        writer = Writer(file, compression=CompressionType[compression.upper()])
        writer.start(profile='ros2')
        channels = []
        for topic in TOPICS:
            schema = schema_of(topic.type_name)
            number = writer.register_schema(topic.type_name, 'ros2msg', schema.text.encode())
            channels.append(writer.register_channel(topic.name, 'cdr', number))
        for number, decision in enumerate(messages):
            for channel, data in zip(channels, decision):
                writer.add_message(channel, number * FRAME_NS, data, number * FRAME_NS)
        writer.finish()
    seconds = time.perf_counter() - began
    target.unlink()
    return seconds


def bench_read(path: Path) -> dict[str, float]:
    """Read all messages, and the images into one array; return rates of ours and of others."""
    file = path / f'{path.name}_0.mcap'
    with BagReader(path) as reader:
        count, images = reader.message_count, reader.topics['/image_raw'].message_count
    ways: dict[str, tuple[int, Callable[[], Any]]] = {
        'messages_per_second': (count, lambda: read_ours(path)),
        'mcap_messages_per_second': (count, lambda: read_mcap(file)),
        'rosbags_messages_per_second': (count, lambda: read_rosbags(path)),
        'image_arrays_per_second': (images, lambda: arrays_ours(path)),
        'mcap_image_arrays_per_second': (images, lambda: arrays_mcap(file)),
        'rosbags_image_arrays_per_second': (images, lambda: arrays_rosbags(path))}
    best: dict[str, float] = defaultdict(float)
    # in turn, so that a busy moment of the machine hits all of them
    for _ in range(REPEATS):
        for name, (amount, read) in ways.items():
            began, cpu = time.perf_counter(), time.process_time()
            read()
            best[name] = max(best[name], amount / (time.perf_counter() - began))
            # other work on the machine stretches the time on the wall, not this
            name = name.replace('per_second', 'per_cpu_second')
            best[name] = max(best[name], amount / (time.process_time() - cpu))
    return best


def read_ours(path: Path) -> int:
    """Count the messages with our reader."""
    with BagReader(path) as reader:
        return sum(1 for _ in reader.messages())


def read_mcap(file: Path) -> int:
    """Count the messages with the mcap library, chunk CRCs checked as ours are."""
    from mcap.reader import make_reader
    with file.open('rb') as stream:
        return sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())


def read_rosbags(path: Path) -> int:
    """Count the messages with rosbags."""
    from rosbags.rosbag2 import Reader
    with Reader(path) as reader:
        return sum(1 for _ in reader.messages())


def arrays_ours(path: Path) -> np.ndarray:
    """Return all images with our reader."""
    with BagReader(path) as reader:
        return load_images(reader)[1]


def arrays_mcap(file: Path) -> np.ndarray:
    """Return all images with the mcap library and its ROS 2 decoder."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    with file.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return np.stack([
            np.frombuffer(item.decoded_message.data, np.uint8)
            for item in reader.iter_decoded_messages(topics=['/image_raw'])])


def arrays_rosbags(path: Path) -> np.ndarray:
    """Return all images with rosbags."""
    from rosbags.rosbag2 import Reader
    types = typestore()
    with Reader(path) as reader:
        wanted = [one for one in reader.connections if one.topic == '/image_raw']
        return np.stack([
            types.deserialize_cdr(data, one.msgtype).data
            for one, _, data in reader.messages(wanted)])


def bench_play(path: Path, period: float) -> dict[str, float]:
    """Pace the bag as the player does, without the middleware; return the timing error."""
    playback = Playback(lambda message: None, rate=1 / period)
    before = sys.getswitchinterval()
    # as the player node sets it
    sys.setswitchinterval(0.0002)
    with BagReader(path) as reader, contextlib.ExitStack() as stack:
        stop = reader.start_time + round(PLAY_SECONDS * 1e9 / period)
        ahead = ReadAhead(reader.messages(stop=stop))
        stack.callback(ahead.close)
        playback.play(ahead)
    sys.setswitchinterval(before)
    middle, worst, most = playback.timing_error()
    return {'p50_ms': 1e3 * middle, 'p99_ms': 1e3 * worst, 'max_ms': 1e3 * most,
            'messages': playback.played}


def show_read(compression: str, written: dict[str, float], read: dict[str, float]) -> None:
    """Print the figures of one compression."""
    show(f'{compression}: {written["megabytes"]:.1f} MB')
    for name, ours, others in (
        ('write', written['messages_per_second'],
         {'mcap': written['mcap_messages_per_second']}),
        ('read', read['messages_per_second'],
         {'mcap': read['mcap_messages_per_second'],
          'rosbags': read['rosbags_messages_per_second']}),
        ('images to arrays', read['image_arrays_per_second'],
         {'mcap': read['mcap_image_arrays_per_second'],
          'rosbags': read['rosbags_image_arrays_per_second']}),
    ):
        beside = ', '.join(f'{other} {rate:,.0f}' for other, rate in others.items())
        show(f'  {name}: {ours:,.0f} messages/s ({beside})')
    show(f'  images to arrays by CPU time: {read["image_arrays_per_cpu_second"]:,.0f} messages/s '
         f'(mcap {read["mcap_image_arrays_per_cpu_second"]:,.0f}, '
         f'rosbags {read["rosbags_image_arrays_per_cpu_second"]:,.0f})')


def show(text: str) -> None:
    """Print a line."""
    sys.stdout.write(text + '\n')


if __name__ == '__main__':
    sys.exit(main())
