# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What is whole in a damaged MCAP file, wherever it lies."""
from __future__ import annotations

from pathlib import Path
import re
import zlib

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from bags.errors import BagError
from bags.mcap_file import McapFile, Span
from bags.mcap_records import (
    CHUNK, HEAD, MAX_CHUNK, MAX_RECORD, MESSAGE, parse_record, record_bytes,
)

# how a chunk of less than 4 GiB begins, up to the name of its compression
CHUNK_BEGINS = re.compile(
    rb'\x06.{4}\x00{4}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd)', re.DOTALL)
# how a short record begins that names topics or says where chunks are
SMALL_RECORD_BEGINS = re.compile(rb'[\x03\x04\x08\x0c].{3}\x00{5}', re.DOTALL)
# how a message outside chunks begins, as rosbag2's preset `fastwrite` writes them
MESSAGE_BEGINS = re.compile(rb'\x05.{4}\x00{4}', re.DOTALL)
# looked through at once, and more than any of these is long
BLOCK_BYTES = 16 << 20
LONGEST = 64
# so many records one behind the other are no accident
CHAIN = 3
# what stands between messages outside chunks
CHAINED = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX, Opcode.METADATA)
# bytes looked at in vain for each byte of the file: one made of such beginnings ends, too
EFFORT = 20
# a few seconds, which no file by accident needs
LEAST_EFFORT = 4 << 30

# where something whole lies: start and end
Place = tuple[int, int]


def open_damaged(path: Path | str) -> tuple[McapFile, int]:
    """
    Open a file with everything in it that is whole.

    Behind damage these are chunks whose CRC is right or that, without one, unpack to records and
    nothing else, where they are found or where the index of the file says that they are;
    messages outside chunks of which several follow each other; and the names of topics. A chunk
    that is there twice is taken once.

    Returns:
        The file, and how many of its bytes belong to nothing that is whole.

    Raises:
        BagError: it cannot be read, or nothing of it is whole.
    """
    file = McapFile(path, strict=False)
    # what seems to be a record of an application may be a chunk whose op code is damaged
    if file.complete and not file.damage and not file.private and all(
            _is_whole(file, span) for span in file.spans):
        return file, 0
    whole = [(0, file.whole_until), *_Salvage(file).places(), (file.size, file.size)]
    if not (file.library or file.spans or file.channels):
        file.close()
        raise BagError(f'{path} is not an MCAP file, or nothing of it is whole')
    lost = end = 0
    for start, stop in sorted(whole):
        lost += max(start - end, 0)
        end = max(end, stop)
    return file, 0 if file.complete else lost


class _Salvage:
    """Adds to a file what is whole behind its damage."""

    def __init__(self, file: McapFile) -> None:
        self._file = file
        self._effort = EFFORT * file.size + LEAST_EFFORT
        # chunks that are whole, by where their records begin
        self._chunks = {span.record: span for span in file.spans
                        if span.record != span.offset and _is_whole(file, span)}
        self._known = set(map(self._content, self._chunks.values()))
        self._indices: list[ChunkIndex] = []
        self._block_start, self._block = 0, b''

    def places(self) -> list[Place]:
        """Add what is whole; return where it lies."""
        found = self._find_chunks()
        found += self._find_small_records(self._gaps(found))
        found += self._follow_index()
        return found + self._find_messages(self._gaps(found, self._file.whole_until))

    def _gaps(self, found: list[Place], start: int = 0) -> list[Place]:
        """Return the stretches behind a byte in which nothing whole was found."""
        inside = sorted([
            *((span.record, _end(span)) for span in self._chunks.values()), *found])
        gaps = []
        for low, high in [*inside, (self._file.size, self._file.size)]:
            if low > start:
                gaps.append((start, low))
            start = max(start, high)
        return gaps

    def _worth(self, cost: int) -> bool:
        """Spend effort, if there is some left."""
        self._effort -= cost
        return self._effort > 0

    def _search(self, pattern: re.Pattern[bytes], start: int, stop: int) -> int | None:
        """Return where a pattern is found next, and all of it before a byte."""
        while start < stop:
            end = self._block_start + len(self._block)
            if not self._block_start <= start <= end - (LONGEST if end < self._file.size else 0):
                self._block_start = start
                self._block = self._file.read(start, min(start + BLOCK_BYTES, self._file.size))
                end = start + len(self._block)
            match = pattern.search(
                self._block, start - self._block_start, min(stop, end) - self._block_start)
            if match:
                return self._block_start + match.start()
            # what begins at the end of a block may go on in the next
            start = stop if end >= stop else end - LONGEST + 1
        return None

    def _find_chunks(self) -> list[Place]:
        file, found, position = self._file, [], 0
        while (start := self._search(CHUNK_BEGINS, position, file.size)) is not None:
            span = self._chunks.get(start)
            if span is None and self._effort > 0:
                try:
                    span = file.read_chunk(start + HEAD.size, file.size)
                    if not _is_whole(file, span):
                        self._worth(span.length + span.unpacked_size)
                        span = None
                except BagError:
                    span = None
                if span is not None:
                    found.append(self._add(span))
            position = _end(span) if span else start + 1
        return found

    def _add(self, span: Span) -> Place:
        content = self._content(span)
        if content not in self._known:
            self._known.add(content)
            self._file.spans.append(span)
        return span.record, _end(span)

    def _content(self, span: Span) -> tuple[int, ...]:
        """Return what two chunks have in common only if they are the same."""
        # without a CRC of what is unpacked, that of what is packed tells as much
        crc = span.crc or zlib.crc32(self._file.read(span.offset, _end(span)))
        return span.start_time, span.end_time, crc, span.unpacked_size

    def _find_small_records(self, gaps: list[Place]) -> list[Place]:
        file, found = self._file, []
        for low, high in gaps:
            position = low
            while (head := self._search(SMALL_RECORD_BEGINS, position, high)) is not None:
                position = head + 1
                opcode, length = HEAD.unpack(file.peek(head, head + HEAD.size))
                end = head + HEAD.size + length
                if end > file.size or length > MAX_RECORD:
                    continue
                if not self._worth(length):
                    return found
                content = file.peek(head + HEAD.size, end)
                try:
                    record = parse_record(opcode, content)
                    if bytes(record_bytes(record))[HEAD.size:] != content:
                        continue
                except (BagError, UnicodeError):
                    continue
                if opcode == Opcode.METADATA:
                    file.metadata.setdefault(record.name, record.metadata)
                elif opcode == Opcode.CHUNK_INDEX:
                    self._indices.append(record)
                else:
                    known = file.schemas if opcode == Opcode.SCHEMA else file.channels
                    known.setdefault(record.id, record)
                found.append((head, end))
        return found

    def _follow_index(self) -> list[Place]:
        """Take the chunks whose head is damaged but whose place and size the index knows."""
        file, found = self._file, []
        for index in self._indices:
            start = index.chunk_start_offset
            offset = start + HEAD.size + CHUNK.size + 4 + len(index.compression.encode()) + 8
            if (start in self._chunks or offset + index.compressed_size > file.size
                    or index.uncompressed_size > MAX_CHUNK
                    or not self._worth(index.compressed_size + index.uncompressed_size)):
                continue
            # the CRC stands in the head; where that is damaged too nothing tells what is whole
            crc = CHUNK.unpack(
                file.peek(start + HEAD.size, start + HEAD.size + CHUNK.size))[3]
            span = Span(offset, index.compressed_size, index.message_start_time,
                        index.message_end_time, index.compression, index.uncompressed_size, crc,
                        start)
            if _is_whole(file, span):
                found.append(self._add(span))
        return found

    def _find_messages(self, gaps: list[Place]) -> list[Place]:
        found = []
        for low, high in gaps:
            position = low
            while (start := self._search(MESSAGE_BEGINS, position, high)) is not None:
                span = self._chain(start, high)
                position = start + 1 if span is None else _end(span)
                if span is not None:
                    self._file.spans.append(span)
                    found.append((start, position))
        return found

    def _chain(self, start: int, stop: int) -> Span | None:
        """Return the messages that follow each other from a byte on, if they are enough."""
        position, times, records = start, [], 0
        while position + HEAD.size <= stop:
            opcode, length = HEAD.unpack(self._file.peek(position, position + HEAD.size))
            end = position + HEAD.size + length
            if end > stop or opcode not in CHAINED:
                break
            if opcode == Opcode.MESSAGE:
                if length < MESSAGE.size or not self._worth(HEAD.size):
                    break
                channel, _, log_time, _ = MESSAGE.unpack(
                    self._file.peek(position + HEAD.size, position + HEAD.size + MESSAGE.size))
                if channel not in self._file.channels:
                    break
                times.append(log_time)
            records += 1
            position = end
        if records < CHAIN:
            return None
        return Span(start, position - start, min(times), max(times), '', position - start, 0,
                    start)


def _end(span: Span) -> int:
    return span.offset + span.length


def _is_whole(file: McapFile, span: Span) -> bool:
    """Return whether a span unpacks to what its CRC says or, without one, to records alone."""
    try:
        data = file.span_bytes(span)
    except BagError:
        return False
    position = 0
    while not span.crc and position < len(data):
        if position + HEAD.size > len(data):
            return False
        opcode, length = HEAD.unpack_from(data, position)
        start, position = position + HEAD.size, position + HEAD.size + length
        if position > len(data) or opcode not in CHAINED:
            return False
        if opcode == Opcode.MESSAGE and not (
                length >= MESSAGE.size
                and span.start_time <= MESSAGE.unpack_from(data, start)[2] <= span.end_time):
            return False
    return bool(len(data))
