# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`metadata.yaml`, as rosbag2 Jazzy writes it (version 9) and in every version it reads.

Layout and version history: rosbag2_storage, `metadata_io.cpp` and `yaml.hpp`.
"""
from __future__ import annotations

import dataclasses
from pathlib import Path, PurePosixPath
from typing import Any

from bags.errors import BagError
from bags.qos_text import normalize_qos, qos_from_text
from msgs_bridge.atomic_write import write_text
from msgs_bridge.regular_file import read_regular
from msgs_bridge.yaml_text import dump_yaml, load_yaml, MAX_TEXT

FILE_NAME = 'metadata.yaml'
VERSION = 9
ROS_DISTRO = 'jazzy'
ROOT = 'rosbag2_bagfile_information'
# starting_time of a bag that holds nothing
NO_TIME = 2 ** 63 - 1


@dataclasses.dataclass(frozen=True)
class TopicMetadata:
    """One topic: name, type, QoS of its publishers, type hash and number of messages."""

    name: str
    type_name: str
    qos: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    type_hash: str = ''
    message_count: int = 0
    serialization_format: str = 'cdr'


@dataclasses.dataclass(frozen=True)
class FileMetadata:
    """One file of the bag: name, first log time and duration in ns, number of messages."""

    path: str
    starting_time: int
    duration: int
    message_count: int


@dataclasses.dataclass(frozen=True)
class BagMetadata:
    """What `metadata.yaml` says of a bag; times in ns since the epoch of its clock."""

    storage_identifier: str = 'mcap'
    starting_time: int = NO_TIME
    duration: int = 0
    message_count: int = 0
    topics: tuple[TopicMetadata, ...] = ()
    files: tuple[FileMetadata, ...] = ()
    compression_format: str = ''
    compression_mode: str = ''
    custom_data: dict[str, str] = dataclasses.field(default_factory=dict)
    ros_distro: str = ROS_DISTRO
    version: int = VERSION


def metadata_body(metadata: BagMetadata) -> dict[str, Any]:
    """Return what stands below the top-level key, also the `rosbag2` record of the MCAP file."""
    return {
        'version': VERSION,
        'storage_identifier': metadata.storage_identifier,
        'duration': {'nanoseconds': metadata.duration},
        'starting_time': {'nanoseconds_since_epoch': metadata.starting_time},
        'message_count': metadata.message_count,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type_name,
                    'serialization_format': topic.serialization_format,
                    'offered_qos_profiles': topic.qos,
                    'type_description_hash': topic.type_hash,
                },
                'message_count': topic.message_count,
            }
            for topic in metadata.topics],
        'compression_format': metadata.compression_format,
        'compression_mode': metadata.compression_mode,
        'relative_file_paths': [file.path for file in metadata.files],
        'files': [
            {
                'path': file.path,
                'starting_time': {'nanoseconds_since_epoch': file.starting_time},
                'duration': {'nanoseconds': file.duration},
                'message_count': file.message_count,
            }
            for file in metadata.files],
        'custom_data': dict(metadata.custom_data) or None,
        'ros_distro': metadata.ros_distro,
    }


def metadata_to_text(metadata: BagMetadata) -> str:
    """Return the text of `metadata.yaml`."""
    return dump_yaml({ROOT: metadata_body(metadata)})


def write_metadata(folder: Path, metadata: BagMetadata) -> None:
    """Write `metadata.yaml` atomically."""
    write_text(folder / FILE_NAME, metadata_to_text(metadata))


def read_metadata(folder: Path) -> BagMetadata:
    """
    Read the `metadata.yaml` of a bag folder.

    Raises:
        BagError: missing, too large, not YAML, or not what rosbag2 writes.
    """
    path = folder / FILE_NAME
    if not path.exists():
        raise BagError(f'{folder} has no {FILE_NAME}: not a bag, or one that was cut off '
                       '(`carracing bag recover` makes it whole)')
    data = read_regular(path, MAX_TEXT, BagError)
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise BagError(f'{path} is not UTF-8 text') from None
    return metadata_from_text(text, str(path))


def metadata_from_text(text: str, what: str) -> BagMetadata:
    """
    Read the text of a `metadata.yaml`; `what` names it in errors.

    Raises:
        BagError: not YAML, or not what rosbag2 writes.
    """
    return _from_content(load_yaml(text, what, BagError), what)


def metadata_from_record(text: str, what: str) -> BagMetadata:
    """
    Read the `rosbag2` record of an MCAP file, which is `metadata.yaml` without its top-level key.

    Raises:
        BagError: not YAML, or not what rosbag2 writes.
    """
    return _from_content({ROOT: load_yaml(text, what, BagError)}, what)


def _from_content(content: dict[str, Any], what: str) -> BagMetadata:
    try:
        return _from_body(content[ROOT], what)
    except KeyError as error:
        raise BagError(f'{what} lacks the key {error}') from None
    except (TypeError, AttributeError):
        raise BagError(f'{what} is not laid out as rosbag2 does') from None


def _from_body(body: dict[str, Any], what: str) -> BagMetadata:
    version = _number(body['version'], 'version', what)
    if not 1 <= version <= VERSION:
        raise BagError(f'{what} is of version {version}; accepted: 1 to {VERSION}')
    starting_time = _number(
        body['starting_time']['nanoseconds_since_epoch'], 'starting_time', what)
    duration = _number(body['duration']['nanoseconds'], 'duration', what)
    message_count = _number(body['message_count'], 'message_count', what)
    names = [_file_name(path, what) for path in body['relative_file_paths']]
    if len(set(names)) < len(names):
        # each of its messages would be there twice
        raise BagError(f'{what} names a file twice')
    described = {}
    for file in body.get('files') or ():
        name = _file_name(file['path'], what)
        described[name] = FileMetadata(
            name,
            _number(file['starting_time']['nanoseconds_since_epoch'], 'starting_time', what),
            _number(file['duration']['nanoseconds'], 'duration', what),
            _number(file['message_count'], 'message_count', what))
    # before version 5 the files are only named
    files = tuple(described.get(name) or FileMetadata(name, starting_time, duration, -1)
                  for name in names)
    custom_data = body.get('custom_data') or {}
    return BagMetadata(
        storage_identifier=str(body['storage_identifier']),
        starting_time=starting_time, duration=duration, message_count=message_count,
        topics=tuple(_topic(entry, what) for entry in body['topics_with_message_count']),
        files=files,
        compression_format=str(body.get('compression_format') or ''),
        compression_mode=_compression_mode(body.get('compression_mode')),
        custom_data={_text(key, what): _text(value, what) for key, value in custom_data.items()},
        ros_distro=str(body.get('ros_distro') or ''),
        version=version)


def _topic(entry: dict[str, Any], what: str) -> TopicMetadata:
    topic = entry['topic_metadata']
    qos = topic.get('offered_qos_profiles') or []
    return TopicMetadata(
        name=str(topic['name']), type_name=str(topic['type']),
        serialization_format=str(topic['serialization_format']),
        qos=qos_from_text(qos) if isinstance(qos, str) else normalize_qos(qos),
        type_hash=str(topic.get('type_description_hash') or ''),
        message_count=_number(entry['message_count'], 'message_count', what))


def _text(value: Any, what: str) -> str:
    text = str(value)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise BagError(f'{what} holds half a surrogate pair, which is no text') from None
    return text


def _compression_mode(value: Any) -> str:
    mode = str(value or '').lower()
    return '' if mode == 'none' else mode


def _number(value: Any, key: str, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2 ** 64:
        raise BagError(f'{what}: {key} is {value!r}; expected a whole number from 0')
    return value


def _file_name(path: Any, what: str) -> str:
    """Return the name of a file inside the folder; before version 4 its folder stood before it."""
    pure = PurePosixPath(str(path))
    if pure.is_absolute() or '..' in pure.parts or not pure.name:
        raise BagError(f'{what} names the file {str(path)!r}, which is not inside the bag')
    return pure.name
