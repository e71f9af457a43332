# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A whole bag, open for reading: our own, rosbag2's (MCAP and sqlite3), or a single file.

What the files hold counts, not what `metadata.yaml` says of it; where the two differ it is said.
"""
from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from bags.errors import BagError
from bags.mcap_file import McapFile, MOST_OPEN
from bags.messages import BagMessage, BagTopic, Storage
from bags.metadata import BagMetadata, FILE_NAME, read_metadata
from bags.qos_text import qos_from_text
from bags.schemas import Schema
from bags.sqlite_storage import SqliteStorage


class BagReader:
    """
    A bag, open for reading; also a context manager.

    Attributes:
        path: the bag.
        metadata: its `metadata.yaml`; None for a single file, or for a cut-off bag.
        files: the data files.
        topics: name -> topic.
        start_time, end_time: first and last log time in ns; 0 if it is empty.
        message_count: messages in the files.
        storage: `mcap` or `sqlite3`.
        custom_data: what the recorder was told about the run.
        problems: what does not fit together but does not keep it from being read.
    """

    def __init__(self, path: Path | str, *, strict: bool = True) -> None:
        """
        Open a bag folder or a single file.

        Args:
            path: folder with `metadata.yaml`, or one `.mcap` or `.db3` file.
            strict: refuse a bag that is cut off; otherwise read up to the cut.

        Raises:
            BagError: it is not there, not a bag, damaged, or cut off (if strict).
        """
        self.path = Path(path)
        self.problems: list[str] = []
        self.metadata: BagMetadata | None = None
        self.files = self._find_files(strict)
        self.storage = 'sqlite3' if self.files[0].suffix == '.db3' else 'mcap'
        if self.storage == 'sqlite3':
            self._storage: Storage = SqliteStorage(
                self.files, packed=bool(self.metadata and self.metadata.compression_mode))
        else:
            self._storage = McapStorage(self.files, strict=strict, problems=self.problems)
        self.topics = self._storage.topics
        self.start_time = self._storage.start_time
        self.end_time = self._storage.end_time
        self.message_count = self._storage.message_count
        self._compare()

    @property
    def custom_data(self) -> dict[str, str]:
        """Return the origin of the run, from `metadata.yaml` or else from the file itself."""
        if self.metadata is not None and self.metadata.custom_data:
            return self.metadata.custom_data
        return dict(self._storage.provenance)

    def database_damage(self) -> list[str]:
        """Read all of a sqlite3 bag; return what is wrong, each a sentence; none of MCAP."""
        return self._storage.damage() if isinstance(self._storage, SqliteStorage) else []

    @property
    def mcap_files(self) -> list[McapFile]:
        """Return the open MCAP files, none for sqlite3."""
        return list(self._storage.files)

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[BagMessage]:
        """
        Yield messages by log time.

        Args:
            topics: names of topics; None = all.
            start: first log time, in ns.
            stop: first log time that is not wanted any more, in ns.

        Raises:
            BagError: a topic that is not in the bag, or damaged data.
        """
        names = self.topics if topics is None else topics
        for name in names:
            if name not in self.topics:
                accepted = ', '.join(sorted(self.topics))
                raise BagError(f'{self.path} has no topic {name!r}; it has {accepted}')
        return self._storage.messages(
            names, 0 if start is None else start, 2 ** 64 if stop is None else stop)

    def close(self) -> None:
        """Let go of the files; arrays made from messages stay valid."""
        self._storage.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _find_files(self, strict: bool) -> list[Path]:
        if not self.path.exists():
            raise BagError(f'{self.path} does not exist')
        if not self.path.is_dir():
            # a FIFO or a device would never end
            if not self.path.is_file():
                raise BagError(f'{self.path} is not a regular file')
            if self.path.suffix in ('.zstd', '.zst', '.lz4'):
                raise BagError(f'{self.path} is compressed as a whole; unpack it with '
                               '`ros2 bag convert`')
            return [self.path]
        if not strict and not (self.path / FILE_NAME).exists():
            self.problems.append(f'there is no {FILE_NAME}')
            files = data_files(self.path)
            if not files:
                raise BagError(f'{self.path} holds no .mcap file')
            return files
        self.metadata = read_metadata(self.path)
        if self.metadata.storage_identifier not in ('mcap', 'sqlite3'):
            raise BagError(f'{self.path} has storage {self.metadata.storage_identifier!r}; '
                           'accepted: mcap, sqlite3')
        mode = self.metadata.compression_mode
        packed = self.metadata.compression_format
        if mode and (mode, packed, self.metadata.storage_identifier) != (
                'message', 'zstd', 'sqlite3'):
            raise BagError(
                f'{self.path} is compressed {mode} by {mode}; unpack it with `ros2 bag convert`, '
                'or record with chunk compression')
        if not self.metadata.files:
            raise BagError(f'{self.path}/{FILE_NAME} names no files')
        files = [self.path / file.path for file in self.metadata.files]
        for file in files:
            if not file.is_file():
                raise BagError(f'{self.path}/{FILE_NAME} names {file.name}, which is not there '
                               'as a regular file')
        return files

    def _compare(self) -> None:
        """Note where `metadata.yaml` and the files tell different stories."""
        if self.metadata is None:
            return
        told, found = self.metadata.message_count, self.message_count
        if told != found:
            self.problems.append(
                f'{FILE_NAME} says {told} messages, the files hold {found}')
        for topic in self.metadata.topics:
            if topic.name not in self.topics:
                if topic.message_count:
                    self.problems.append(f'{FILE_NAME} says there is {topic.name}, there is not')
            elif topic.type_name != self.topics[topic.name].type_name:
                self.problems.append(
                    f'{FILE_NAME} says {topic.name} is {topic.type_name}, '
                    f'the files say {self.topics[topic.name].type_name}')
            elif topic.qos:
                # also that of publishers who came after the first message
                self.topics[topic.name].qos = topic.qos
        for name in self.topics.keys() - {topic.name for topic in self.metadata.topics}:
            self.problems.append(f'{FILE_NAME} does not name the topic {name}')


class McapStorage:
    """The MCAP files of a bag, one after another."""

    def __init__(self, paths: list[Path], *, strict: bool, problems: list[str]) -> None:
        """
        Open the files.

        Raises:
            BagError: one is not MCAP, damaged, or cut off (if strict).
        """
        self.files: list[McapFile] = []
        self.topics: dict[str, BagTopic] = {}
        self.provenance: dict[str, str] = {}
        try:
            for path in paths:
                file = McapFile(path, strict=strict)
                self.files.append(file)
                if not (file.library or file.spans or file.channels):
                    raise BagError(f'{path} is not an MCAP file')
                if not file.complete:
                    problems.append(f'{path.name} is cut off: {file.problem}')
                problems.extend(file.damage)
                self._learn_channels(file)
                self.provenance.update(file.metadata.get('provenance', {}))
                if len(paths) > MOST_OPEN:
                    file.close()
        except BaseException:
            self.close()
            raise
        filled = {file: file.filled_spans() for file in self.files}
        self.files.sort(key=lambda file: min(
            (span.start_time for span in filled[file]), default=2 ** 64))
        spans = [span for some in filled.values() for span in some]
        self.start_time = min((span.start_time for span in spans), default=0)
        self.end_time = max((span.end_time for span in spans), default=0)
        self.message_count = sum(topic.message_count for topic in self.topics.values())

    def messages(
        self, names: Collection[str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield messages by log time, file after file as rosbag2 does."""
        for file in self.files:
            channels = {number: channel.topic for number, channel in file.channels.items()
                        if channel.topic in names}
            for message in file.messages(channels, start, stop):
                yield BagMessage(
                    channels[message.channel], message.log_time, message.publish_time,
                    message.data)

    def close(self) -> None:
        """Let go of the files."""
        for file in self.files:
            file.close()

    def _learn_channels(self, file: McapFile) -> None:
        counts = file.counts
        if not file.complete or not file.channels or not counts:
            # a summary that repeats channels and counts is optional: read everything once
            counts = {}
            for span in file.spans:
                for message in file.span_messages(span):
                    counts[message.channel] = counts.get(message.channel, 0) + 1
        for number in counts.keys() - file.channels.keys():
            raise BagError(f'{file.path} has messages of channel {number}, which it never names')
        for number, channel in file.channels.items():
            schema = file.schemas.get(channel.schema_id)
            metadata = channel.metadata
            type_name = schema.name if schema else ''
            text = schema.data.decode('utf-8', 'replace') if schema else ''
            topic = BagTopic(
                channel.topic, type_name,
                Schema(type_name, schema.encoding if schema else '', text,
                       metadata.get('topic_type_hash', '')),
                qos_from_text(metadata.get('offered_qos_profiles', '')),
                counts.get(number, 0), channel.message_encoding)
            known = self.topics.setdefault(channel.topic, topic)
            if known is topic:
                continue
            if known.type_name != type_name:
                raise BagError(f'{file.path}: {channel.topic} is of type {type_name} and of type '
                               f'{known.type_name}')
            if known.encoding != topic.encoding:
                raise BagError(f'{file.path}: {channel.topic} is encoded as {topic.encoding} and '
                               f'as {known.encoding}')
            known.message_count += topic.message_count


def data_files(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder in the order of their numbers."""
    return sorted(folder.glob('*.mcap'), key=lambda path: (file_number(path), path.name))


def file_number(path: Path) -> int:
    """Return the number at the end of a file's name, 0 without one."""
    tail = path.stem.rpartition('_')[2]
    return int(tail) if tail.isdecimal() else 0
