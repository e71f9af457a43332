# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
One MCAP file, read with bounds: nothing is believed that the file says of its own sizes.

It is read and never mapped into memory: who reads a map of a file that somebody cuts short
meanwhile is killed.
"""
from __future__ import annotations

from array import array
from collections.abc import Container, Iterator, Sequence
import contextlib
import dataclasses
import heapq
import io
import os
from pathlib import Path
import stat
from typing import NamedTuple
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
import numpy as np

from bags.compression import unpack
from bags.errors import BagError
from bags.mcap_records import (
    CHUNK, HEAD, MAGIC, MAX_CHUNK, MAX_RECORD, MESSAGE, MESSAGE_HEAD, parse_record, PROFILE,
)

# Chunks that overlap in time are merged; more than this unpacked at once is refused.
MAX_UNPACKED = 1 << 30
# Messages outside chunks (rosbag2's preset `fastwrite`) are read in stretches of this many bytes.
STRETCH_BYTES = 4 << 20
# read at once on the way from record to record: a page, for what lies in a chunk is not needed
WINDOW_BYTES = 4096
# of a bag of more files than these none stays open: a process may have some hundred
MOST_OPEN = 16
# the longest name of a compression
MAX_NAME = 16
ENCODING = 'cdr'

# op codes of the specification, and those it leaves to applications; in a damaged file any other
# one means that the place is wrong
KNOWN_OPCODES = range(0x01, 0x10)
PRIVATE_OPCODES = range(0x80, 0x100)


class RawMessage(NamedTuple):
    """One message: log and publish time in ns, the channel of its file, serialized bytes."""

    log_time: int
    publish_time: int
    channel: int
    data: memoryview


class SpanMessages(Sequence[RawMessage]):
    """
    Messages of a span, each made when it is asked for.

    A chunk may hold a message in every 31 bytes, and an object of Python for each of them would be
    ten times its size.
    """

    def __init__(self, data: memoryview, places: array, times: array) -> None:
        """Take the unpacked span, and where in it messages begin with their log times in ns."""
        self._data, self._places, self.times = data, places, times

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> RawMessage:
        data, place = self._data, self._places[number]
        _, length, channel, _, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, place)
        return RawMessage(log_time, publish_time, channel,
                          data[place + MESSAGE_HEAD.size:place + HEAD.size + length])

    def between(self, start: int, stop: int) -> Iterator[RawMessage]:
        """Yield those of `start` <= log time < `stop` by log time."""
        times = np.frombuffer(self.times, np.uint64)
        order = range(len(times))
        if len(times) > 1 and (times[1:] < times[:-1]).any():
            order = np.argsort(times, kind='stable')
        for number in order:
            if start <= self.times[number] < stop:
                yield self[number]


@dataclasses.dataclass(frozen=True)
class Span:
    """
    A stretch of the file that holds messages: a chunk, or messages one after another.

    Attributes:
        offset, length: where the messages, packed or not, lie in the file.
        record: where the record of the chunk begins.
        start_time, end_time: first and last log time in ns.
        compression, unpacked_size, crc: of a chunk; for plain messages empty, length and 0.
    """

    offset: int
    length: int
    start_time: int
    end_time: int
    compression: str
    unpacked_size: int
    crc: int
    record: int


class McapFile:
    """
    An MCAP file of profile ros2, open for reading.

    Attributes:
        path: the file.
        schemas, channels: by number.
        spans: where messages lie, in order of the file.
        metadata: name -> values of the metadata records; of two of one name the last.
        library: what wrote it.
        data_end: where the data section ends, and its CRC as the file says it; 0 if it does not.
        summary: where the summary begins and the footer ends, as the file is laid out.
        complete: whether the file ends as it should.
        problem: why it is not complete, in words.
        whole_until: where the records that follow each other from the start end.
        damage: what was passed over because it is damaged, each a sentence (if not strict).
        private: records of an application that were passed over.
    """

    def __init__(self, path: Path | str, *, strict: bool = True) -> None:
        """
        Open a file and read through its records, chunks unopened.

        Args:
            path: the file.
            strict: refuse a file that is cut off or damaged; otherwise read what is whole, which
                of a file of another kind is nothing (`salvage` looks further).

        Raises:
            BagError: not an MCAP file, another profile, damaged or cut off (if strict).
        """
        self.path = Path(path)
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.spans: list[Span] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.counts: dict[int, int] = {}
        self.library = ''
        self.data_end = (0, 0)
        self.summary = (0, 0)
        self.complete = False
        self.problem = ''
        self.whole_until = 0
        self.damage: list[str] = []
        self.private = 0
        self._plain: list[int] = []
        self._window_start, self._window = 0, b''
        try:
            self._file = self._open()
            self._status = os.fstat(self._file.fileno())
        except OSError as error:
            raise BagError(f'{path}: {error.strerror}') from None
        self.size = self._status.st_size
        try:
            self._scan(strict)
            if strict and not self.complete:
                raise BagError(f'{path} is cut off: {self.problem}; '
                               '`carracing bag recover` keeps what is whole')
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file; what is read of it from now on opens it for that moment alone."""
        self._file.close()

    def __enter__(self) -> McapFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def peek(self, start: int, stop: int) -> bytes:
        """
        Return a few bytes of the file, read together with those behind them.

        Raises:
            BagError: as `read`.
        """
        if stop - start > WINDOW_BYTES:
            return self.read(start, stop)
        place = start - self._window_start
        if place < 0 or place + stop - start > len(self._window):
            self._window = self.read(start, max(stop, min(start + WINDOW_BYTES, self.size)))
            self._window_start, place = start, 0
        return self._window[place:place + stop - start]

    def read(self, start: int, stop: int) -> bytes:
        """
        Return bytes of the file as they are now.

        Raises:
            BagError: it has been cut short or replaced, or the disk fails.
        """
        try:
            parts, there = [], min(stop, self.size)
            with self._opened() as number:
                while start < there and (part := os.pread(number, there - start, start)):
                    parts.append(part)
                    start += len(part)
        except OSError as error:
            raise BagError(f'{self.path}: {error.strerror}') from None
        if start < stop:
            raise BagError(f'{self.path} was cut short meanwhile')
        return parts[0] if len(parts) == 1 else b''.join(parts)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[int]:
        """Hold a descriptor of the file, a new one if it was let go of."""
        if not self._file.closed:
            yield self._file.fileno()
            return
        with self._open() as file:
            if not os.path.samestat(os.fstat(file.fileno()), self._status):
                raise BagError(f'{self.path} was replaced meanwhile')
            yield file.fileno()

    def _open(self) -> io.FileIO:
        # opening a FIFO would wait for somebody to write into it
        if not stat.S_ISREG(self.path.stat().st_mode):
            raise BagError(f'{self.path} is not a regular file')
        return self.path.open('rb', buffering=0)

    def span_bytes(self, span: Span, *, check: bool = True) -> memoryview:
        """
        Return the unpacked records of a span.

        Raises:
            BagError: it does not unpack, or its CRC is wrong.
        """
        packed = self.read(span.offset, span.offset + span.length)
        try:
            unpacked = unpack(span.compression, packed, span.unpacked_size)
        except BagError as error:
            raise BagError(f'{self.path} at byte {span.offset}: {error}') from None
        if check and span.crc and zlib.crc32(unpacked) != span.crc:
            raise BagError(f'{self.path} at byte {span.offset}: the CRC of the chunk is wrong')
        return memoryview(unpacked)

    def span_messages(
        self, span: Span, channels: Container[int] | None = None, *, check: bool = True,
    ) -> SpanMessages:
        """
        Return the messages of a span in the order of the file.

        Schemas and channels in it are taken into `schemas` and `channels`.

        Raises:
            BagError: it is damaged.
        """
        data = self.span_bytes(span, check=check)
        places, times = array('Q'), array('Q')
        position, end = 0, len(data)
        head, head_size = HEAD.unpack_from, HEAD.size
        message_head, message_size = MESSAGE.unpack_from, MESSAGE.size
        while position < end:
            start = position + head_size
            if start > end:
                raise self._damaged(span, 'a record is cut off')
            opcode, length = head(data, position)
            if start + length > end:
                raise self._damaged(span, f'a record of {length} bytes reaches beyond it')
            if opcode == 5:
                if length < message_size:
                    raise self._damaged(span, f'a message of {length} bytes')
                channel, _, log_time, _ = message_head(data, start)
                if channels is None or channel in channels:
                    places.append(position)
                    times.append(log_time)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(opcode, data[start:start + length])
            position = start + length
        return SpanMessages(data, places, times)

    def filled_spans(self) -> list[Span]:
        """Return the spans that hold messages; a chunk without any says 0 for both times."""
        return [span for span in self.spans if span.end_time or self._holds_messages(span)]

    def messages(
        self,
        channels: Container[int] | None = None,
        start: int = 0,
        stop: int = 2 ** 64,
    ) -> Iterator[RawMessage]:
        """
        Yield messages by log time, `start` <= log time < `stop`, order of the file among equals.

        Raises:
            BagError: the file is damaged, or too much of it overlaps in time.
        """
        spans = sorted(
            (span for span in self.spans if span.end_time >= start and span.start_time < stop),
            key=lambda span: (span.start_time, span.offset))
        pending: list[tuple[int, int, int, Iterator[RawMessage], RawMessage]] = []
        held: dict[int, int] = {}
        for number, span in enumerate(spans):
            # everything before this span begins can go out, one span at a time
            yield from self._drain(pending, held, span.start_time)
            held[number] = span.unpacked_size
            if sum(held.values()) > MAX_UNPACKED:
                raise BagError(f'{self.path}: chunks of more than {MAX_UNPACKED} bytes '
                               'overlap in time')
            inside = self.span_messages(span, channels)
            if len(inside) and not (
                    span.start_time <= min(inside.times)
                    and max(inside.times) <= span.end_time):
                # messages would be left out, or come before those of another chunk
                raise self._damaged(span, 'it says another time than its messages; `carracing bag '
                                          'recover` writes it anew')
            following = inside.between(start, stop)
            first = next(following, None)
            if first is None:
                del held[number]
            else:
                heapq.heappush(pending, (first.log_time, number, 0, following, first))
        yield from self._drain(pending, held, 2 ** 64)

    @staticmethod
    def _drain(
        pending: list, held: dict[int, int], until: int,
    ) -> Iterator[RawMessage]:
        """Yield what is pending with a log time below `until`."""
        while pending and pending[0][0] < until:
            _, number, count, following, message = pending[0]
            limit = min(until, pending[1][0]) if len(pending) > 1 else until
            if len(pending) > 2:
                limit = min(limit, pending[2][0])
            # as long as this span is the earliest its messages need no heap
            while True:
                yield message
                message = next(following, None)
                if message is None or message.log_time >= limit:
                    break
            if message is None:
                heapq.heappop(pending)
                del held[number]
            else:
                heapq.heapreplace(
                    pending, (message.log_time, number, count + 1, following, message))

    def _holds_messages(self, span: Span) -> bool:
        # what is damaged is told where it is read
        with contextlib.suppress(BagError):
            return bool(self.span_messages(span))
        return False

    def _scan(self, strict: bool) -> None:
        """Go through the records of the file and note where messages lie."""
        if strict and (self.size < len(MAGIC) or self.read(0, len(MAGIC)) != MAGIC):
            raise BagError(f'{self.path} is not an MCAP file')
        self.whole_until = self._walk(len(MAGIC), strict=strict)

    def _walk(self, position: int, *, strict: bool) -> int:
        """
        Take record after record; return where it cannot go on.

        Raises:
            BagError: a damaged record (if strict), or a file of another kind.
        """
        begin = position
        while True:
            if position + HEAD.size > self.size:
                self.problem = f'it ends at byte {self.size} within a record'
                break
            opcode, length = HEAD.unpack(self.peek(position, position + HEAD.size))
            start = position + HEAD.size
            if start + length > self.size:
                self.problem = (f'the record at byte {position} needs {length} bytes, '
                                f'{self.size - start} are there')
                break
            if opcode in PRIVATE_OPCODES:
                self.private += 1
            elif not strict and opcode not in KNOWN_OPCODES:
                self.problem = f'there is no record at byte {position}'
                break
            try:
                if position == len(MAGIC):
                    self._check_header(opcode, self._content(start, length))
                self._take(opcode, position, start, length)
            except BagError as error:
                if strict:
                    raise
                self.damage.append(str(error))
            position = start + length
            if opcode == Opcode.FOOTER:
                end = min(position + len(MAGIC), self.size)
                self.complete = self.peek(position, end) == MAGIC
                self.problem = '' if self.complete else 'it has no end mark'
                position += len(MAGIC)
                break
        self._add_plain()
        if begin == position == len(MAGIC) and strict:
            raise BagError(f'{self.path} is cut off: it has no header')
        return position

    def _take(self, opcode: int, position: int, start: int, length: int) -> None:
        """Take what is worth knowing of one record."""
        if opcode == Opcode.MESSAGE:
            self._extend_plain(position, start, length)
            return
        self._add_plain()
        if opcode == Opcode.CHUNK:
            self.spans.append(self.read_chunk(start, start + length))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._learn(opcode, self._content(start, length))
        elif opcode == Opcode.METADATA:
            record = self._record(opcode, start, length)
            self.metadata[record.name] = record.metadata
        elif opcode == Opcode.STATISTICS:
            self.counts = dict(self._record(opcode, start, length).channel_message_counts)
        elif opcode == Opcode.DATA_END:
            self.data_end = (position, self._record(opcode, start, length).data_section_crc)
            self.summary = (start + length, 0)
        elif opcode == Opcode.FOOTER:
            self.summary = (self.summary[0], start + length)

    def _content(self, start: int, length: int) -> bytes:
        """Return the content of a record, or as much of it as is too much for one."""
        return self.peek(start, start + min(length, MAX_RECORD + 1))

    def _record(self, opcode: int, start: int, length: int) -> object:
        return self._parse(opcode, self._content(start, length))

    def _check_header(self, opcode: int, content: bytes) -> None:
        if opcode != Opcode.HEADER:
            raise BagError(f'{self.path} does not begin with a header')
        header = self._parse(opcode, content)
        profile, self.library = header.profile, header.library
        if profile != PROFILE:
            raise BagError(f'{self.path} has profile {profile!r}; accepted: {PROFILE!r}')

    def read_chunk(self, start: int, end: int) -> Span:
        """
        Return the chunk whose content begins at a byte and ends before `end`.

        Raises:
            BagError: there is none that can be one.
        """
        if end - start < CHUNK.size + 12:
            raise BagError(f'{self.path} at byte {start}: a chunk of {end - start} bytes')
        name = CHUNK.size + 4
        head = self.peek(start, min(start + name + MAX_NAME + 8, end))
        first, last, size, crc = CHUNK.unpack_from(head)
        name_end = name + int.from_bytes(head[CHUNK.size:name], 'little')
        data = start + name_end + 8
        if name_end - name > MAX_NAME or data > end:
            raise BagError(f'{self.path} at byte {start}: the chunk is damaged')
        packed = int.from_bytes(head[name_end:name_end + 8], 'little')
        if data + packed > end:
            raise BagError(f'{self.path} at byte {start}: the chunk is damaged')
        if size > MAX_CHUNK:
            raise BagError(f'{self.path} at byte {start}: chunk says it unpacks to {size} bytes; '
                           f'accepted: {MAX_CHUNK}')
        compression = head[name:name_end].decode('ascii', 'replace')
        return Span(data, packed, first, last, compression, size, crc, start - HEAD.size)

    def _extend_plain(self, position: int, start: int, length: int) -> None:
        """Add a message outside chunks to the present stretch: [start, end, first, last]."""
        if length < MESSAGE.size:
            raise BagError(f'{self.path} at byte {position}: a message of {length} bytes')
        log_time = MESSAGE.unpack(self.peek(start, start + MESSAGE.size))[2]
        if self._plain and start + length - self._plain[0] > STRETCH_BYTES:
            self._add_plain()
        if not self._plain:
            self._plain = [position, start + length, log_time, log_time]
        else:
            self._plain[1] = start + length
            self._plain[2] = min(self._plain[2], log_time)
            self._plain[3] = max(self._plain[3], log_time)

    def _add_plain(self) -> None:
        if self._plain:
            start, end, first, last = self._plain
            self.spans.append(Span(start, end - start, first, last, '', end - start, 0, start))
            self._plain = []

    def _learn(self, opcode: int, content: bytes | memoryview) -> None:
        known = self.schemas if opcode == Opcode.SCHEMA else self.channels
        record = self._parse(opcode, content)
        known[record.id] = record

    def _parse(self, opcode: int, content: bytes | memoryview) -> object:
        try:
            return parse_record(opcode, content)
        except BagError as error:
            raise BagError(f'{self.path}: {error}') from None

    def _damaged(self, span: Span, why: str) -> BagError:
        return BagError(f'{self.path}: the chunk at byte {span.offset} is damaged: {why}')
