# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One MCAP file, written chunk by chunk, as rosbag2's MCAP storage lays it out.

A chunk holds schemas and channels when they are first used, and messages; behind it stands its
message index. Each chunk goes to the operating system in one piece, so that a killed process
leaves whole chunks and at most one torn one.
"""
from __future__ import annotations

from array import array
from collections.abc import Mapping
import errno
import os
from pathlib import Path
import sys
import zlib

from mcap.opcode import Opcode
from mcap.records import (
    Channel, ChunkIndex, DataEnd, Footer, Header, Metadata, MetadataIndex, Schema, Statistics,
    SummaryOffset,
)

from bags.compression import COMPRESSIONS, packer
from bags.errors import BagError
from bags.mcap_records import (
    CHUNK, HEAD, INDEX_HEAD, LIBRARY, MAGIC, MESSAGE, MESSAGE_HEAD, PROFILE, record_bytes,
)


class McapFileWriter:
    """
    Writes one new file; never over an existing one.

    Attributes:
        message_count, start_time, end_time: of all messages added; log times in ns.
        size: bytes in the file so far, without the open chunk.
        open_messages: messages in the open chunk, what a crash would cost now.
        open_bytes: their bytes.
    """

    def __init__(self, path: Path, *, compression: str = 'none') -> None:
        """
        Create the file.

        Raises:
            BagError: it exists, cannot be created, or the compression is unknown.
        """
        self.path = path
        self._pack = packer(compression)
        self._compression = COMPRESSIONS[compression]
        self.message_count = 0
        self.start_time = 0
        self.end_time = 0
        self.open_messages = 0
        self.open_bytes = 0
        self.size = 0
        self._parts: list[bytes] = []
        self._indexes: dict[int, array] = {}
        self._first = self._last = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        # of everything before the record DataEnd, so that a flipped byte anywhere is found
        self._crc = 0
        try:
            self._file = path.open('xb', buffering=0)
        except FileExistsError:
            raise BagError(f'{path} exists already; nothing was overwritten') from None
        except OSError as error:
            raise BagError(f'{path}: {error.strerror}') from None
        self._put(MAGIC + record_bytes(Header(profile=PROFILE, library=LIBRARY)))

    def add_schema(self, name: str, encoding: str, text: str) -> int:
        """Add a schema to the open chunk; return its number."""
        number = len(self._schemas) + 1
        self._schemas[number] = Schema(
            id=number, name=name, encoding=encoding, data=text.encode())
        self._append(record_bytes(self._schemas[number]))
        return number

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str],
    ) -> int:
        """Add a channel to the open chunk; return its number."""
        number = len(self._channels) + 1
        self._channels[number] = Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema,
            metadata=dict(metadata))
        self._counts[number] = 0
        self._append(record_bytes(self._channels[number]))
        return number

    def add_message(self, channel: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Add a message to the open chunk; times in ns."""
        index = self._indexes.get(channel)
        if index is None:
            index = self._indexes[channel] = array('Q')
        index.append(log_time)
        index.append(self.open_bytes)
        size = len(data)
        self._parts.append(MESSAGE_HEAD.pack(
            Opcode.MESSAGE, MESSAGE.size + size, channel, 0, log_time, publish_time))
        self._parts.append(data)
        self.open_bytes += MESSAGE_HEAD.size + size
        if self.open_messages == 0:
            self._first = self._last = log_time
        elif log_time > self._last:
            self._last = log_time
        elif log_time < self._first:
            self._first = log_time
        self.open_messages += 1

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once, outside the chunks."""
        record = record_bytes(Metadata(name=name, metadata=dict(values)))
        offset = self.size
        self._put(record)
        self._metadata_indexes.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def flush(self) -> None:
        """
        Close the open chunk and hand it to the operating system.

        Raises:
            OSError: the disk is full or gone; the file then ends with its last whole chunk and
                the messages of the open one are lost.
        """
        if not self.open_messages:
            return
        chunk, index, record = self._chunk()
        start = self.size
        first = self.message_count == 0
        self._put(b''.join((*chunk, *record)))
        index.chunk_start_offset = start
        index.message_index_offsets = {
            channel: start + offset for channel, offset in index.message_index_offsets.items()}
        self._chunk_indexes.append(index)
        self.start_time = self._first if first else min(self.start_time, self._first)
        self.end_time = self._last if first else max(self.end_time, self._last)
        self.message_count += self.open_messages
        for channel, entries in self._indexes.items():
            self._counts[channel] += len(entries) // 2
        self._clear()

    def drop_open_chunk(self) -> int:
        """Forget the open chunk after a failed `flush`; return how many messages were in it."""
        lost = self.open_messages
        self._clear()
        # schemas and channels may have been in it, and the summary names them anyway
        return lost

    def check_place(self) -> None:
        """
        Look whether the file is still the one at its path; writing to a removed one never fails.

        Raises:
            OSError: it was removed, moved, replaced or cut short.
        """
        mine = os.fstat(self._file.fileno())
        try:
            there = self.path.stat()
        except FileNotFoundError:
            there = None
        if there is None or not os.path.samestat(mine, there):
            raise OSError(
                errno.ENOENT, f'{self.path.name} was removed, moved or replaced meanwhile')
        if mine.st_size < self.size:
            raise OSError(errno.EIO, f'{self.path.name} was cut short meanwhile')

    def finish(self) -> None:
        """
        Write index and footer; the file is complete then.

        Raises:
            OSError: the disk is full or gone.
        """
        self.flush()
        self._put(record_bytes(DataEnd(self._crc)) + self._summary())

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()

    @property
    def counts(self) -> dict[str, int]:
        """Return topic -> messages in whole chunks."""
        return {channel.topic: self._counts[number] for number, channel in self._channels.items()}

    def _append(self, record: bytes) -> None:
        self._parts.append(record)
        self.open_bytes += len(record)

    def _clear(self) -> None:
        self._parts.clear()
        self._indexes.clear()
        self.open_bytes = self.open_messages = 0

    def _chunk(self) -> tuple[tuple[bytes, ...], ChunkIndex, list[bytes]]:
        """Return the bytes of the chunk, its index entry, and its message index records."""
        unpacked = b''.join(self._parts)
        packed = self._pack(unpacked)
        name = self._compression.encode()
        head = b''.join((
            HEAD.pack(Opcode.CHUNK, CHUNK.size + 4 + len(name) + 8 + len(packed)),
            CHUNK.pack(self._first, self._last, len(unpacked), zlib.crc32(unpacked)),
            len(name).to_bytes(4, 'little'), name, len(packed).to_bytes(8, 'little')))
        length = len(head) + len(packed)
        index = ChunkIndex(
            chunk_length=length, chunk_start_offset=0, compression=self._compression,
            compressed_size=len(packed), message_end_time=self._last, message_index_length=0,
            message_index_offsets={}, message_start_time=self._first,
            uncompressed_size=len(unpacked))
        records = []
        for channel, entries in self._indexes.items():
            index.message_index_offsets[channel] = length + index.message_index_length
            if sys.byteorder == 'big':
                entries = array('Q', entries)
                entries.byteswap()
            content = entries.tobytes()
            records.append(INDEX_HEAD.pack(
                Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)) + content)
            index.message_index_length += len(records[-1])
        return (head, packed), index, records

    def _summary(self) -> bytes:
        start = self.size + HEAD.size + 4
        statistics = Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunk_indexes),
            message_count=self.message_count, metadata_count=len(self._metadata_indexes),
            message_start_time=self.start_time, message_end_time=self.end_time,
            schema_count=len(self._schemas))
        groups = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes))
        parts, offsets, size = [], [], 0
        for opcode, records in groups:
            if not records:
                continue
            content = b''.join(map(record_bytes, records))
            offsets.append(SummaryOffset(
                group_opcode=opcode, group_start=start + size, group_length=len(content)))
            parts.append(content)
            size += len(content)
        parts.extend(map(record_bytes, offsets))
        footer = record_bytes(Footer(
            summary_start=start, summary_offset_start=start + size, summary_crc=0))
        parts.append(footer[:-4])
        summary = b''.join(parts)
        return summary + zlib.crc32(summary).to_bytes(4, 'little') + MAGIC

    def _put(self, data: bytes) -> None:
        """Write all of it, or leave the file as long as it was."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view):]
        except OSError:
            # a torn record at the end would hide that everything before it is whole
            os.ftruncate(self._file.fileno(), self.size)
            self._file.seek(self.size)
            raise
        self.size += len(data)
        self._crc = zlib.crc32(data, self._crc)
