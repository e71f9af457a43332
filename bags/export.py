# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A lap as a video and as a table."""
from __future__ import annotations

from collections.abc import Iterator
import csv
from fractions import Fraction
import glob
import io
import itertools
from pathlib import Path

from bags.decode import decode_bundle
from bags.episodes import frame_seconds
from bags.errors import BagError
from bags.frames import recorded_frames, RecordedFrame
from bags.painter import FramePainter
from bags.reader import BagReader
from bags.steps import decode_step, usable
from bags.topic_lookup import find_topic, need_topic
from msgs_bridge.atomic_write import atomic_file, remove_leftovers
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.topics import Q_VALUES, STEP

# seconds that the last picture of an episode stays
PAUSE = 0.5
# what a video counts time in at least, in seconds
SHORTEST_TICK = Fraction(1, 100_000)
# muxer and its options, encoder and its options, and seconds from picture to picture at least
FORMATS = {
    # its length is in milliseconds else, and pictures beyond it are shown by nobody
    '.mp4': ('mp4', {'movie_timescale': str(SHORTEST_TICK.denominator)}, 'libx264',
             {'crf': '18'}, 0.0),
    # for pages: plays by itself, again and again, and has to stay small
    '.webp': ('webp', {'loop': '0'}, 'libwebp_anim', {'quality': '50'}, 0.1),
}
MAX_SCALE = 20
# rows or columns of a picture in the video
MAX_SIDE = 2160
# of a table; every row has all of them
MAX_COLUMNS = 2000
# simulated frames that a picture stays at most, whatever a bag says; more than an action is held
MAX_FRAMES = 1000
# what is drawn where the first image is missing: width and height of CarRacing's
UNSEEN = (96, 96)


def export_csv(
    reader: BagReader, path: Path | str, *, namespace: str = '', episode: int | None = None,
) -> int:
    """
    Write a row per published frame: stamp, the `step` values, and Q-values as `q_NAME`.

    Args:
        reader: the bag.
        path: new file.
        namespace: where the topics of the car are; needed if there are several.
        episode: only this one; None = all.

    Returns:
        The number of rows.

    Raises:
        BagError: the file exists, the bag is damaged, lacks the episode, or has values of too
            many names.
    """
    _prepare(path)
    frames = _chosen(reader, namespace, episode)
    names, actions = _columns(reader, namespace, episode)
    rows = 0
    with atomic_file(path) as file:
        text = io.TextIOWrapper(file, encoding='utf-8', newline='', write_through=True)
        table = csv.writer(text, lineterminator='\n')
        table.writerow(['stamp', *names, *(f'q_{name}' for name in actions)])
        for frame in frames:
            values = frame.step.values()
            table.writerow([
                f'{frame.stamp / NANOSECONDS:.9f}',
                *(_number(values.get(name)) for name in names),
                *(_number(frame.q_values.get(name)) for name in actions)])
            rows += 1
        text.detach()
    return rows


def export_video(
    reader: BagReader, path: Path | str, *, namespace: str = '', episode: int | None = None,
    scale: int = 4, speed: float = 1.0,
) -> int:
    """
    Write a video with reward, speed, controls and Q-values beside the frame.

    Args:
        reader: the bag.
        path: new `.mp4` file (H.264), or `.webp`, of ten pictures a second at most.
        namespace: where the topics of the car are; needed if there are several.
        episode: only this one; None = all.
        scale: size of a pixel of the frame in pixels of the video.
        speed: 2 = twice as fast as the car drove.

    Returns:
        The number of pictures.

    Raises:
        BagError: the file exists, the bag is damaged, or lacks the episode.
    """
    # the encoder is needed for nothing else in this package
    import av

    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise BagError(f'{path}: a video is written as {" or ".join(FORMATS)}')
    muxer, muxing, codec, encoding, apart = FORMATS[suffix]
    _prepare(path)
    if not 1 <= scale <= MAX_SCALE:
        raise BagError(f'scale is {scale}; accepted: 1 to {MAX_SCALE}')
    if not 0.01 <= speed <= 100:
        raise BagError(f'speed is {speed:g}; accepted: 0.01 to 100')
    seconds = frame_seconds(reader, namespace=namespace)
    base = max(Fraction(seconds / speed).limit_denominator(SHORTEST_TICK.denominator),
               SHORTEST_TICK)
    painter: FramePainter | None = None
    pictures = time = due = 0
    q_values: dict[str, float] = {}
    with atomic_file(path) as file, av.open(
            file, 'w', format=muxer, options=muxing) as container:
        stream = container.add_stream(codec, rate=1 / base, options=encoding)
        stream.pix_fmt = 'yuv420p'
        stream.codec_context.time_base = base
        for frame in _chosen(reader, namespace, episode):
            if painter is None:
                width, height = UNSEEN if frame.pixels is None else frame.pixels.shape[1::-1]
                if max(width, height) * scale > MAX_SIDE:
                    raise BagError(f'a frame of {width}x{height}, {scale} times as large; '
                                   f'accepted: up to {MAX_SIDE} to a side')
                painter = FramePainter(width, height, scale)
                stream.width, stream.height = painter.width, painter.height
            # the last frame of an episode leads to no decision
            q_values = frame.q_values or q_values
            if pictures:
                passed = min(max(int(frame.step.info.get('frames', 1)), 0), MAX_FRAMES)
                time += passed or max(round(PAUSE / seconds), 1)
            if time < due:
                continue
            due = time + round(apart / base)
            picture = av.VideoFrame.from_ndarray(painter.paint(frame, q_values), format='rgb24')
            picture.pts, picture.time_base = time, base
            container.mux(stream.encode(picture))
            pictures += 1
        container.mux(stream.encode(None))
    return pictures


def _columns(
    reader: BagReader, namespace: str, episode: int | None,
) -> tuple[list[str], list[str]]:
    """Return the names of the `step` values and of the Q-values: any may come late in a bag."""
    steps = need_topic(reader, STEP, namespace=namespace)
    q_values = find_topic(reader, Q_VALUES, namespace=namespace)
    names: dict[str, None] = {}
    actions: dict[str, None] = {}
    for _, (_, step) in usable(
            reader.messages([steps]), lambda data: decode_step(data, steps)):
        if episode in (None, step.episode):
            names.update(dict.fromkeys(step.values()))
    for _, values in usable(
            reader.messages([q_values]) if q_values else (),
            lambda data: decode_bundle(data, q_values).values_with()):
        actions.update(dict.fromkeys(values))
    if len(names) + len(actions) > MAX_COLUMNS:
        raise BagError(f'{reader.path} has values of {len(names) + len(actions)} names; '
                       f'accepted: up to {MAX_COLUMNS}')
    return list(names), list(actions)


def _chosen(
    reader: BagReader, namespace: str, episode: int | None,
) -> Iterator[RecordedFrame]:
    """Yield the frames of one episode or of all, at least one."""
    frames = (frame for frame in recorded_frames(reader, namespace=namespace)
              if episode is None or frame.step.episode == episode)
    first = next(frames, None)
    if first is None:
        what = 'frames' if episode is None else f'episode {episode}'
        raise BagError(f'{reader.path} has no {what}')
    return itertools.chain([first], frames)


def _prepare(path: Path | str) -> None:
    """Refuse what cannot be written, and remove what a killed export of it has left."""
    if Path(path).exists():
        raise BagError(f'{path} exists already; nothing was overwritten')
    if not Path(path).resolve().parent.is_dir():
        raise BagError(f'{Path(path).parent} is not a folder')
    remove_leftovers(Path(path).parent, glob.escape(Path(path).name))


def _number(value: float | None) -> str:
    """Return a number without a needless `.0`, every bit of it kept."""
    if value is None:
        return ''
    return str(int(value)) if value.is_integer() else repr(value)
