# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag in the layout of rosbag2 Jazzy: NAME/NAME_0.mcap, NAME_1.mcap, ... and metadata.yaml."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
import dataclasses
import os
from pathlib import Path
import time
from typing import Any

from bags.errors import BagError
from bags.mcap_file_writer import McapFileWriter
from bags.metadata import (
    BagMetadata, FileMetadata, metadata_body, NO_TIME, TopicMetadata, write_metadata,
)
from bags.qos_text import qos_to_text
from bags.schemas import Schema, schema_of
from msgs_bridge.yaml_text import dump_yaml, MAX_TEXT

# The library's own default is 768 KiB; a chunk is what a crash costs at most.
CHUNK_BYTES = 1 << 20
# What metadata.yaml says of a file has so many characters, its name not counted, which is there
# twice. Half of what may be read goes to files, the rest to topics.
FILE_TEXT = 260
MOST_FILE_TEXT = MAX_TEXT // 2
MOST_TOPICS = 5000
ROSBAG2_RECORD = 'rosbag2'
PROVENANCE_RECORD = 'provenance'


@dataclasses.dataclass
class _Topic:
    name: str
    schema: Schema
    qos: list[dict[str, Any]]
    encoding: str
    channel: int = 0
    message_count: int = 0


class BagWriter:
    """
    Writes a new bag; `close` makes it complete, as the end of a `with` does that goes well.

    One that is left by an error is removed: nobody shall believe half of it later.

    Attributes:
        folder: the bag.
        message_count: messages taken, the open chunk included.
        lost: messages lost because the disk was full or gone.
        closed: whether the bag is complete.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        compression: str = 'none',
        chunk_bytes: int = CHUNK_BYTES,
        chunk_seconds: float = 1.0,
        split_bytes: int = 0,
        split_seconds: float = 0.0,
        custom_data: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Create the folder and its first file.

        Args:
            folder: must not exist; its parent is made if it does not.
            compression: `none`, `lz4` or `zstd`, chunk by chunk.
            chunk_bytes: size at which a chunk is closed, bytes before packing.
            chunk_seconds: wall time after which `tick` closes a chunk.
            split_bytes: size at which the next file is begun; 0 = never. Of some thousand files
                the last takes the rest, for `metadata.yaml` has to stay readable.
            split_seconds: span of log time after which the next file is begun; 0 = never.
            custom_data: texts for `metadata.yaml` and for a metadata record in every file.
            clock: seconds that only go forward.

        Raises:
            BagError: the folder exists or cannot be made, or the compression is unknown.
        """
        self.folder = Path(folder)
        self._compression = compression
        self._chunk_bytes = chunk_bytes
        self._chunk_seconds = chunk_seconds
        self._split_bytes = split_bytes
        self._split_nanoseconds = round(split_seconds * 1e9)
        self._custom_data = dict(custom_data or {})
        self._clock = clock
        self._chunk_opened = 0.0
        self._topics: list[_Topic] = []
        self._schemas: dict[Schema, int] = {}
        self._files: list[FileMetadata] = []
        self._split_at: int | None = None
        self.message_count = 0
        self.lost = 0
        self.closed = False
        name = self.folder.resolve().name
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{self.folder} exists already; nothing was overwritten') from None
        except OSError as error:
            raise BagError(f'cannot create {self.folder}: {error.strerror}') from None
        self._name = name
        self._place = self.folder.stat()
        self._most_files = MOST_FILE_TEXT // (FILE_TEXT + 2 * len(dump_yaml(name)))
        try:
            self._begin_file()
        except BaseException:
            # an empty folder would only be in the way of the next attempt
            self._remove()
            raise

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Sequence[dict[str, Any]] = (),
        *,
        schema: Schema | None = None,
        encoding: str = 'cdr',
    ) -> int:
        """
        Add a topic; return the number that `write` takes.

        Args:
            name: fully qualified name.
            type_name: `package/msg/Type`.
            qos: one profile per publisher, see `qos_text.offered_qos`.
            schema: definition; looked up on this machine if not given.
            encoding: serialization of the messages.

        Raises:
            BagError: more topics than `metadata.yaml` can name and still be read.
        """
        if len(self._topics) == MOST_TOPICS:
            raise BagError(f'{self.folder}: a bag has {MOST_TOPICS} topics at most')
        topic = _Topic(name, schema or schema_of(type_name), list(qos), encoding)
        self._topics.append(topic)
        self._register(topic)
        return len(self._topics) - 1

    def add_offers(self, topic: int, qos: Sequence[dict[str, Any]]) -> None:
        """Replace the profiles of a topic's publishers, for `metadata.yaml` and files to come."""
        self._topics[topic].qos = list(qos)

    def note(self, key: str, text: str) -> None:
        """Add a text to `custom_data`, for `metadata.yaml` and the record at a file's end."""
        self._custom_data[key] = text

    def check_place(self) -> None:
        """
        Look whether the bag is still where it was begun.

        Raises:
            OSError: its folder or its present file was removed, moved or replaced; `lost` says
                what it cost.
        """
        try:
            self._file.check_place()
        except OSError:
            self._file.drop_open_chunk()
            kept = sum(file.message_count for file in self._files
                       if (self.folder / file.path).exists())
            self.lost += self.message_count - kept
            self.message_count = kept
            raise

    def write(self, topic: int, log_time: int, publish_time: int, data: bytes) -> None:
        """
        Write a serialized message; log and publish time in ns.

        Raises:
            OSError: the disk is full or gone; `lost` says what it cost.
        """
        file = self._file
        if (self._split_at is not None and log_time >= self._split_at) or (
                self._split_bytes and file.size + file.open_bytes >= self._split_bytes
                and file.message_count + file.open_messages):
            self.next_file()
            file = self._file
        if file.open_messages == 0:
            self._chunk_opened = self._clock()
            if self._split_nanoseconds and file.message_count == 0:
                self._split_at = log_time + self._split_nanoseconds
        entry = self._topics[topic]
        file.add_message(entry.channel, log_time, publish_time, data)
        entry.message_count += 1
        self.message_count += 1
        if file.open_bytes >= self._chunk_bytes:
            self._guard(file.flush)

    def tick(self) -> None:
        """
        Close a chunk that has been open for `chunk_seconds`; call it now and then.

        Raises:
            OSError: the disk is full or gone; `lost` says what it cost.
        """
        if (self._file.open_messages
                and self._clock() - self._chunk_opened >= self._chunk_seconds):
            self._guard(self._file.flush)

    def next_file(self) -> None:
        """
        Complete the present file and begin the next one, if the bag may have one more.

        Raises:
            OSError: the disk is full or gone; `lost` says what it cost.
        """
        if len(self._files) + 1 < self._most_files:
            self._guard(self._next_file)
        else:
            self._split_at, self._split_bytes, self._split_nanoseconds = None, 0, 0

    @property
    def size(self) -> int:
        """Return the bytes of the present file, the open chunk included."""
        return self._file.size + self._file.open_bytes

    def close(self) -> None:
        """
        Complete the last file and write `metadata.yaml`; a second call does nothing.

        Raises:
            OSError: the disk is full or gone; `carracing bag recover` can still read it.
        """
        if self.closed:
            return
        self.closed = True
        try:
            self.check_place()
            self._end_file(last=True)
        finally:
            self._file.close()
        write_metadata(self.folder, self.metadata())

    def metadata(self) -> BagMetadata:
        """Return what `metadata.yaml` says of the files that are complete."""
        filled = [file for file in self._files if file.message_count]
        start = min((file.starting_time for file in filled), default=NO_TIME)
        end = max((file.starting_time + file.duration for file in filled), default=start)
        return BagMetadata(
            starting_time=start, duration=end - start,
            message_count=sum(file.message_count for file in self._files),
            topics=tuple(
                TopicMetadata(
                    topic.name, topic.schema.type_name, topic.qos, topic.schema.type_hash,
                    topic.message_count, topic.encoding)
                for topic in self._topics),
            files=tuple(self._files), custom_data=self._custom_data)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            if not self.closed:
                self._give_up()
            return
        try:
            self.close()
        except BaseException:
            self._give_up()
            raise

    def _give_up(self) -> None:
        self.closed = True
        self._file.close()
        # the error that led here says more than one of these would
        with contextlib.suppress(OSError):
            self._remove()

    def _remove(self) -> None:
        """Remove the bag, if its place is not somebody else's meanwhile."""
        if not os.path.samestat(self._place, self.folder.stat()):
            return
        for number in range(len(self._files) + 1):
            self._path(number).unlink(missing_ok=True)
        self.folder.rmdir()

    def _path(self, number: int) -> Path:
        return self.folder / f'{self._name}_{number}.mcap'

    def _guard(self, act: Callable[[], None]) -> None:
        try:
            act()
        except OSError:
            self.lost += self._file.drop_open_chunk()
            self._recount()
            raise

    def _recount(self) -> None:
        """Set the counts to what is in whole chunks, after some were lost."""
        counts = self._file.counts
        for topic in self._topics:
            topic.message_count = self._done.get(topic.name, 0) + counts.get(topic.name, 0)
        self.message_count = sum(topic.message_count for topic in self._topics)

    def _begin_file(self) -> None:
        self._done = {topic.name: topic.message_count for topic in self._topics}
        self._file = McapFileWriter(
            self._path(len(self._files)), compression=self._compression)
        self._file.add_metadata(ROSBAG2_RECORD, self._rosbag2_record(BagMetadata(
            custom_data=self._custom_data)))
        if self._custom_data:
            # also in a file that is cut off, where metadata.yaml never comes to be
            self._file.add_metadata(PROVENANCE_RECORD, self._custom_data)
        self._split_at = None
        self._schemas.clear()
        for topic in self._topics:
            self._register(topic)

    def _end_file(self, *, last: bool = False) -> None:
        file = self._file
        self._guard(file.flush)
        self._files.append(FileMetadata(
            file.path.name, file.start_time if file.message_count else NO_TIME,
            file.end_time - file.start_time, file.message_count))
        metadata = self.metadata()
        if not last:
            # all files in each would make the time for a bag grow with the square of their number
            metadata = dataclasses.replace(metadata, files=metadata.files[-1:])
        file.add_metadata(ROSBAG2_RECORD, self._rosbag2_record(metadata))
        file.finish()

    def _next_file(self) -> None:
        self._end_file()
        self._file.close()
        self._begin_file()

    def _register(self, topic: _Topic) -> None:
        """Name schema and channel of a topic in the present file."""
        number = self._schemas.get(topic.schema)
        if number is None:
            number = self._schemas[topic.schema] = self._file.add_schema(
                topic.schema.type_name, topic.schema.encoding, topic.schema.text)
        topic.channel = self._file.add_channel(topic.name, topic.encoding, number, {
            'offered_qos_profiles': qos_to_text(topic.qos),
            'topic_type_hash': topic.schema.type_hash,
        })

    @staticmethod
    def _rosbag2_record(metadata: BagMetadata) -> dict[str, str]:
        return {'serialized_metadata': dump_yaml(metadata_body(metadata))}
