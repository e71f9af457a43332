# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag holds, as `ros2 bag info` shows it, and the episodes in it."""
from __future__ import annotations

from collections import Counter
import dataclasses
import datetime
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from bags.episodes import Episode, find_episodes
from bags.reader import BagReader
from msgs_bridge.plain_text import plain

# characters of a value of the bag that are shown; --json has all
SHOWN = 200

MANY_EPISODES = 20


def bag_info(reader: BagReader, *, namespace: str = '') -> dict[str, Any]:
    """
    Return everything that is worth knowing of a bag, as JSON can hold it; times in ns.

    Raises:
        BagError: a damaged bag.
    """
    seconds = (reader.end_time - reader.start_time) / 1e9
    counts: Counter[str] = Counter()
    episodes = find_episodes(reader, namespace=namespace, counts=counts)
    # all of them, if it is somebody else's topic of that name
    if counts['rejected']:
        reader.problems.append(f'{counts["rejected"]} messages of step cannot be used')
    whole = [episode for episode in episodes if episode.whole]
    return {
        'path': str(reader.path),
        'storage': reader.storage,
        'ros_distro': reader.metadata.ros_distro if reader.metadata else '',
        'files': [{'name': file.name, 'bytes': file.stat().st_size} for file in reader.files],
        'bytes': sum(file.stat().st_size for file in reader.files),
        'compression': _compression(reader),
        'start_time': reader.start_time,
        'end_time': reader.end_time,
        'seconds': seconds,
        'messages': reader.message_count,
        'topics': [
            {
                'name': topic.name, 'type': topic.type_name, 'messages': topic.message_count,
                'rate': topic.message_count / seconds if seconds > 0 else 0.0,
                'serialization': topic.encoding, 'publishers': len(topic.qos),
                'reliability': _policies(topic.qos, 'reliability'),
                'durability': _policies(topic.qos, 'durability'),
                'type_hash': topic.schema.type_hash,
            }
            for topic in sorted(reader.topics.values(), key=lambda topic: topic.name)],
        'custom_data': reader.custom_data,
        'problems': reader.problems,
        'episodes': [dataclasses.asdict(episode) for episode in episodes],
        'laps': sum(episode.lap_finished for episode in episodes),
        'whole_episodes': len(whole),
        'mean_return': (sum(episode.episode_return for episode in whole) / len(whole)
                        if whole else None),
    }


def show_info(info: dict[str, Any], console: Console) -> None:
    """Print what `bag_info` returned as tables."""
    console.print(Group(_head(info), _topics(info), _episodes(info)))


def _head(info: dict[str, Any]) -> Table:
    table = Table.grid(padding=(0, 2))
    names = ', '.join(file['name'] for file in info['files'])
    rows = [
        ('bag', info['path']),
        ('files', names if len(info['files']) <= 4 else f'{len(info["files"])} files'),
        ('size', _size(info['bytes'])),
        ('storage', ', '.join(filter(None, (
            info['storage'], info['compression'], info['ros_distro'])))),
        ('start', _time_of_day(info['start_time'])),
        ('duration', f'{info["seconds"]:.3f} s'),
        ('messages', f'{info["messages"]:,}'),
    ]
    rows += [(f'problem {number}', problem)
             for number, problem in enumerate(info['problems'], 1)]
    # names out of the bag, which must not be taken for what was found
    rows += [('custom_data', '')] * bool(info['custom_data'])
    rows += [(f'  {plain(name)}', value) for name, value in info['custom_data'].items()]
    for name, value in rows:
        table.add_row(Text(name, style='bold'), Text(plain(value, SHOWN)))
    return table


def _time_of_day(nanoseconds: int) -> str:
    try:
        moment = datetime.datetime.fromtimestamp(nanoseconds / 1e9)
    except (OverflowError, ValueError, OSError):
        # beyond what a calendar has: somebody's clock was no clock
        return f'{nanoseconds} ns'
    return moment.strftime('%Y-%m-%d %H:%M:%S.%f')[:-3]


def _topics(info: dict[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column('topic', overflow='fold')
    table.add_column('type', overflow='fold')
    table.add_column('messages', justify='right')
    table.add_column('rate / s', justify='right')
    table.add_column('publishers', overflow='fold')
    for topic in info['topics']:
        table.add_row(
            Text(plain(topic['name'], SHOWN)), Text(plain(topic['type'], SHOWN)),
            f'{topic["messages"]:,}', f'{topic["rate"]:.1f}',
            Text(plain(f'{topic["publishers"]} {topic["reliability"]} '
                       f'{topic["durability"]}')))
    return table


def _episodes(info: dict[str, Any]) -> Group | Table | Text:
    episodes = [Episode(**episode) for episode in info['episodes']]
    if not episodes:
        return Text('no episodes')
    table = Table(box=None, pad_edge=False)
    for column in ('episode', 'seed', 'decisions', 'frames', 'return'):
        table.add_column(column, justify='right')
    table.add_column('end')
    for number, episode in enumerate(episodes[:MANY_EPISODES], 1):
        seed = '' if episode.seed < 0 else str(episode.seed)
        table.add_row(
            str(episode.number), seed, str(episode.decisions), str(episode.frames),
            f'{episode.episode_return:.1f}', _end(episode, last=number == len(episodes)))
    mean = info['mean_return']
    told = (f'{len(episodes)} episodes, {info["whole_episodes"]} whole, '
            f'{info["laps"]} laps finished')
    if mean is not None:
        told += f', mean return {mean:.1f}'
    if len(episodes) > MANY_EPISODES:
        told += f' (the first {MANY_EPISODES} are shown; --json has all)'
    return Group(table, Text(told))


def _end(episode: Episode, *, last: bool) -> str:
    if episode.lap_finished:
        return 'lap finished'
    if episode.terminated:
        return 'terminated'
    if episode.truncated:
        return 'cut off'
    return 'goes on after the bag' if last else 'reset, or its end was not recorded'


def _policies(profiles: list[dict[str, Any]], name: str) -> str:
    return ', '.join(sorted({profile[name] for profile in profiles}))


def _compression(reader: BagReader) -> str:
    kinds = {span.compression or 'uncompressed' for file in reader.mcap_files
             for span in file.spans}
    return ', '.join(sorted(kinds))


def _size(count: float) -> str:
    for unit in ('B', 'KiB', 'MiB', 'GiB'):
        if count < 1024:
            return f'{count:.1f} {unit}' if unit != 'B' else f'{count} B'
        count /= 1024
    return f'{count:.1f} TiB'
