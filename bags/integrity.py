# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the files of a bag: CRCs, indexes, counts, order."""
from __future__ import annotations

from array import array
from collections import Counter
import sys
import zlib

from mcap.opcode import Opcode

from bags.errors import BagError
from bags.mcap_file import McapFile, Span, SpanMessages
from bags.mcap_records import FOOTER_BYTES, HEAD, LIBRARY, MAGIC, MESSAGE_HEAD
from bags.metadata import BagMetadata, metadata_from_text, ROOT
from bags.reader import BagReader
from msgs_bridge.yaml_text import dump_yaml, load_yaml

# bytes that a CRC is taken of at a time
PIECE = 64 << 20
MAX_NAMED = 20


def structure_problems(reader: BagReader) -> list[str]:
    """Return what is wrong with the files of a bag, each a sentence; empty if nothing is."""
    problems = [*reader.problems, *reader.database_damage()]
    for file in reader.mcap_files:
        found = _Checker(file).problems()
        problems += [f'{file.path.name}: {problem}' for problem in found[:MAX_NAMED]]
        if len(found) > MAX_NAMED:
            problems.append(f'{file.path.name}: and {len(found) - MAX_NAMED} more')
    problems += _metadata_problems(reader)
    return problems


def order_notes(reader: BagReader) -> list[str]:
    """Return what is unusual about the order of messages, each a sentence."""
    notes = []
    if reader.storage == 'sqlite3':
        notes.append('sqlite3 keeps no CRCs: what was changed within a message is not seen')
    for file in reader.mcap_files:
        back, last = 0, 0
        for span in file.spans:
            back += span.end_time > 0 and span.start_time < last
            last = max(last, span.end_time)
        if back:
            notes.append(f'{file.path.name}: {back} chunks begin before the one before has ended')
    return notes


class _Checker:
    def __init__(self, file: McapFile) -> None:
        self._file = file

    def problems(self) -> list[str]:
        return [*self._section_problems(), *self._span_problems()]

    def _section_problems(self) -> list[str]:
        file, found = self._file, []
        end, told = file.data_end
        if told and self._crc(0, end) != told:
            found.append('the CRC of the data section is wrong')
        start, end = file.summary
        if end:
            told = int.from_bytes(file.read(end - 4, end), 'little')
            if told and self._crc(start, end - 4) != told:
                found.append('the CRC of the summary is wrong')
            footer = file.read(end - FOOTER_BYTES + HEAD.size, end)
            named = int.from_bytes(footer[:8], 'little')
            if named not in (0, start):
                found.append(f'the footer puts the summary at byte {named}; it is at {start}')
            if end + len(MAGIC) != file.size:
                found.append(f'{file.size - end - len(MAGIC)} bytes follow the end')
        return found

    def _crc(self, start: int, stop: int) -> int:
        crc = 0
        for begin in range(start, stop, PIECE):
            crc = zlib.crc32(self._file.read(begin, min(begin + PIECE, stop)), crc)
        return crc

    def _span_problems(self) -> list[str]:
        file, found = self._file, []
        counts: Counter[int] = Counter()
        for number, span in enumerate(file.spans):
            try:
                messages = file.span_messages(span)
            except BagError as error:
                found.append(str(error).removeprefix(f'{file.path} '))
                continue
            counts.update(message.channel for message in messages)
            found += [f'chunk {number} at byte {span.record}: {problem}'
                      for problem in self._chunk_problems(span, messages)]
        if file.counts:
            for channel in sorted(counts.keys() | file.counts.keys()):
                told, there = file.counts.get(channel, 0), counts[channel]
                if told != there:
                    name = file.channels[channel].topic if channel in file.channels else channel
                    found.append(f'the summary says {told} messages of {name}, {there} are there')
        return found

    def _chunk_problems(self, span: Span, messages: SpanMessages) -> list[str]:
        if not messages:
            return []
        found = []
        if (span.start_time, span.end_time) != (min(messages.times), max(messages.times)):
            found.append('it says another time than its messages')
        index = self._index_after(span)
        expected = self._index_of(span)
        # some writers sort it by time
        if index and index != expected and _sorted(index) != _sorted(expected):
            found.append('its message index does not fit its messages')
        return found

    def _index_after(self, span: Span) -> dict[int, bytes]:
        """Return channel -> entries of the index records behind a chunk."""
        file = self._file
        position = span.offset + span.length
        index = {}
        while position + HEAD.size <= file.size:
            opcode, length = HEAD.unpack(file.read(position, position + HEAD.size))
            if opcode != Opcode.MESSAGE_INDEX or length < 6:
                break
            start = position + HEAD.size
            content = file.read(start, start + length)
            index[int.from_bytes(content[:2], 'little')] = bytes(content[6:])
            position = start + length
        return index

    def _index_of(self, span: Span) -> dict[int, bytes]:
        """Return the index as it should be."""
        entries: dict[int, array] = {}
        data = self._file.span_bytes(span, check=False)
        position = 0
        while position < len(data):
            opcode, length = HEAD.unpack_from(data, position)
            if opcode == Opcode.MESSAGE:
                _, _, channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, position)
                entries.setdefault(channel, array('Q')).extend((log_time, position))
            position += HEAD.size + length
        if sys.byteorder == 'big':
            for values in entries.values():
                values.byteswap()
        return {channel: values.tobytes() for channel, values in entries.items()}


def _sorted(index: dict[int, bytes]) -> dict[int, list[bytes]]:
    """Return the entries of an index in one order, without the channels that have none."""
    return {channel: sorted(content[place:place + 16] for place in range(0, len(content), 16))
            for channel, content in index.items() if content}


def _metadata_problems(reader: BagReader) -> list[str]:
    """Compare `metadata.yaml` with the copy in the last file; only ours holds the same."""
    if reader.metadata is None:
        return []
    # not the last by time, for that may have been set back
    last = [file for file in reader.mcap_files
            if file.path.name == reader.metadata.files[-1].path]
    if not last or last[0].library != LIBRARY:
        return []
    text = last[0].metadata.get('rosbag2', {}).get('serialized_metadata', '')
    try:
        body = load_yaml(text, 'the rosbag2 record', BagError)
        copy = metadata_from_text(dump_yaml({ROOT: body}), 'the rosbag2 record')
    except BagError as error:
        return [str(error)]
    if _told(copy) != _told(reader.metadata):
        return ['metadata.yaml differs from its copy in the last file']
    return []


def _told(metadata: BagMetadata) -> tuple:
    """Return what matters of a metadata.yaml: `ros2 bag reindex` writes the rest anew."""
    topics = {(topic.name, topic.type_name, topic.type_hash, topic.message_count,
               topic.serialization_format) for topic in metadata.topics}
    return (metadata.storage_identifier, metadata.starting_time, metadata.duration,
            metadata.message_count, topics, metadata.custom_data, metadata.compression_mode,
            [file.path for file in metadata.files])
