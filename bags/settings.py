# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the recorder and of the player, described once for parameters, help and docs."""
from __future__ import annotations

from collections.abc import Callable
import dataclasses

from msgs_bridge.settings import setting
from msgs_bridge.topics import IMAGE_ANNOTATED

from bags.compression import COMPRESSIONS
from bags.errors import BagError
from bags.writer import CHUNK_BYTES

ALL = 'all'


@dataclasses.dataclass(frozen=True)
class RecorderSettings:
    """What `bag_recorder_node` records, and how it writes it."""

    folder: str = setting(
        '', 'new folder of the bag; empty = bag_ and the time of day in the current folder')
    topics: str = setting(
        ALL, 'topics to record, separated by commas; all = every topic, as it appears')
    exclude: str = setting(
        IMAGE_ANNOTATED.name, 'topics not to record, separated by commas; the annotated picture '
        'is made of the others, and only while somebody takes it')
    compression: str = setting(
        'lz4', 'compression of the chunks', choices=tuple(COMPRESSIONS))
    chunk_bytes: int = setting(
        CHUNK_BYTES, 'size in bytes at which a chunk goes to the disk', low=1024, high=64 << 20)
    chunk_seconds: float = setting(
        1.0, 'seconds after which a chunk goes to the disk however small', low=0.01, high=3600)
    split_bytes: int = setting(
        0, 'size in bytes at which the next file is begun; 0 = never', low=0, high=1 << 50)
    split_seconds: float = setting(
        0.0, 'seconds after which the next file is begun; 0 = never', low=0, high=1e7)
    cache_bytes: int = setting(
        100 << 20, 'bytes that may wait for the disk; what comes while they are full is lost '
        'and counted',
        low=1 << 20, high=1 << 34)
    depth: int = setting(
        2000, 'messages a topic that may wait in DDS',
        low=100, high=100_000)
    provenance: str = setting(
        '', 'JSON object with the origin of the run, for custom_data and a metadata record')


@dataclasses.dataclass(frozen=True)
class PlayerSettings:
    """What `bag_player_node` plays, and when."""

    bag: str = setting('', 'bag to play: a folder or a single file')
    topics: str = setting(
        ALL, 'topics to play, separated by commas; all = every topic of the bag')
    remaps: str = setting('', 'from:=to pairs of topic names, separated by commas')
    prefix: str = setting('', 'goes before the name of every topic that is not remapped: /car1')
    rate: float = setting(
        1.0, 'speed; 2 = twice as fast as recorded, 0 = as fast as possible',
        low=0, high=1e4, live=True)
    start_offset: float = setting(
        0.0, 'seconds of the bag to skip at its start', low=0, high=1e9)
    duration: float = setting(
        0.0, 'seconds of the bag to play; 0 = to its end', low=0, high=1e9)
    loop: bool = setting(False, 'start again at the end')
    start_paused: bool = setting(False, 'wait for ~/pause or ~/step before the first message')
    clock_rate: float = setting(
        0.0, 'messages a second on /clock with the time of the bag; 0 = none',
        low=0, high=1000)
    wait_for_subscribers: float = setting(
        3.5, 'seconds to wait at most until every topic played has a subscriber; '
        'DDS may need 3 s to find one', low=0, high=3600)
    answer_timeout: float = setting(
        0.0, 'seconds to wait for the twist that answers an image_raw, played as fast as answers '
        'come and without the recorded cmd_vel; 0 = play by time', low=0, high=3600)


def names_of(text: str) -> list[str]:
    """Return the names in a comma-separated setting."""
    return [name.strip() for name in text.split(',') if name.strip()]


def chosen_names(text: str, resolve: Callable[[str], str]) -> list[str]:
    """
    Return the full names of the topics in a setting that has to choose some.

    Args:
        text: what was set.
        resolve: what ROS makes of a name.

    Raises:
        BagError: no name at all, or one that ROS refuses.
    """
    names = resolved_names(text, resolve)
    if not names:
        raise BagError(f'topics is {text[:100]!r}, which chooses none; {ALL} = every topic')
    return names


def resolved_names(text: str, resolve: Callable[[str], str]) -> list[str]:
    """
    Return the full names of the topics in a comma-separated setting.

    Args:
        text: what was set.
        resolve: what ROS makes of a name.

    Raises:
        BagError: a name that ROS refuses.
    """
    names = []
    for name in names_of(text):
        try:
            names.append(resolve(name))
        except Exception:
            # rcl has an exception for each way in which a name may be wrong, and a text of lines
            raise BagError(f'{name[:100]!r} cannot be the name of a topic') from None
    return names
