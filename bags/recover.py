# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Make a bag that was cut off whole: every whole chunk, with index and `metadata.yaml`."""
from __future__ import annotations

import contextlib
import dataclasses
from itertools import pairwise
from pathlib import Path

from bags.compression import COMPRESSIONS
from bags.errors import BagError
from bags.mcap_file import ENCODING, McapFile, MOST_OPEN
from bags.metadata import BagMetadata, FILE_NAME, metadata_from_record, read_metadata
from bags.qos_text import qos_from_text
from bags.reader import data_files, file_number
from bags.salvage import open_damaged
from bags.schemas import Schema
from bags.writer import BagWriter, PROVENANCE_RECORD, ROSBAG2_RECORD

# what one topic is written as: a definition may have changed from one file to the next
Topics = dict[tuple[str, Schema, str], int]


@dataclasses.dataclass
class Recovery:
    """
    What was saved of a bag, and what was not.

    Attributes:
        messages: saved.
        chunks: saved.
        bad_chunks: left out because they do not unpack or their CRC is wrong.
        lost_bytes: of the files, at their torn ends and in bad chunks.
        remarks: what was lost and why, each a sentence.
    """

    messages: int = 0
    chunks: int = 0
    bad_chunks: int = 0
    lost_bytes: int = 0
    remarks: list[str] = dataclasses.field(default_factory=list)


def recover_bag(source: Path | str, target: Path | str) -> Recovery:
    """
    Copy everything that is whole in a bag into a new one; the source is not touched.

    Args:
        source: a bag folder, with or without `metadata.yaml`, or one MCAP file.
        target: new folder.

    Raises:
        BagError: nothing can be read of the source, or the target exists or cannot be written;
            what was begun of it is removed then, as after Ctrl-C.
    """
    source = Path(source)
    if not source.exists():
        raise BagError(f'{source} does not exist')
    paths = data_files(source) if source.is_dir() else [source]
    if not paths:
        raise BagError(f'{source} holds no .mcap file; others cannot be recovered here')
    recovery = Recovery()
    files = []
    try:
        for path in paths:
            try:
                file, lost = open_damaged(path)
                files.append(file)
                if len(paths) > MOST_OPEN:
                    file.close()
                if not file.complete:
                    recovery.lost_bytes += lost
                    recovery.remarks.append(
                        f'{path.name}: {file.problem}; {lost} bytes were lost')
            except BagError as error:
                with contextlib.suppress(OSError):
                    recovery.lost_bytes += path.stat().st_size
                recovery.remarks.append(f'{error}; nothing of it could be saved')
        if not files:
            raise BagError(recovery.remarks[0])
        told = _told(files)
        if source.is_dir():
            if (source / FILE_NAME).exists():
                with contextlib.suppress(BagError):
                    told.append(read_metadata(source))
            else:
                recovery.remarks.append(f'there was no {FILE_NAME}')
            recovery.remarks += _missing(paths, told)
        try:
            _copy(files, told, Path(target), recovery)
        except OSError as error:
            raise BagError(f'{target}: {error.strerror}; nothing was kept of it') from None
    finally:
        for file in files:
            file.close()
    return recovery


def _told(files: list[McapFile]) -> list[BagMetadata]:
    """Return what the newest `rosbag2` records say of the bag, the newest last."""
    told: list[BagMetadata] = []
    for file in reversed(files):
        text = file.metadata.get(ROSBAG2_RECORD, {}).get('serialized_metadata', '')
        with contextlib.suppress(BagError):
            told.insert(0, metadata_from_record(text, 'the rosbag2 record'))
            # one from the end of a file tells of all before it
            if told[0].files:
                break
    return told


def _missing(paths: list[Path], told: list[BagMetadata]) -> list[str]:
    """Return a sentence for each file that was named and for each gap in the numbers."""
    there = {path.name for path in paths}
    named = sorted({file.path for metadata in told for file in metadata.files} - there)
    remarks = [f'{name} is not there as an .mcap file; nothing of it could be saved'
               for name in named]
    numbers = [file_number(Path(name)) for name in named]
    for before, after in pairwise(paths):
        low, high = file_number(before), file_number(after)
        lacking = high - low - 1 - sum(low < number < high for number in numbers)
        if lacking > 0:
            remarks.append(f'between {before.name} and {after.name} files are missing: {lacking}; '
                           'nothing of them could be saved')
    return remarks


def _copy(
    files: list[McapFile], told: list[BagMetadata], target: Path, recovery: Recovery,
) -> None:
    compression = next((span.compression for file in files for span in file.spans), '')
    names = {name: kind for kind, name in COMPRESSIONS.items()}
    with BagWriter(
        target, compression=names.get(compression, 'zstd'),
        custom_data=_custom_data(files, told),
    ) as writer:
        topics: Topics = {}
        for number, file in enumerate(files):
            if number:
                writer.next_file()
            _copy_file(file, writer, topics, recovery)
        for metadata in told:
            for topic in metadata.topics:
                # also that of publishers who came after the first message
                if topic.qos:
                    for (name, schema, _), number in topics.items():
                        if (name, schema.type_name) == (topic.name, topic.type_name):
                            writer.add_offers(number, topic.qos)
        recovery.messages = writer.message_count


def _copy_file(
    file: McapFile, writer: BagWriter, topics: Topics, recovery: Recovery,
) -> None:
    recovery.remarks += [f'{damage}; it was left out' for damage in file.damage]
    unnamed = 0
    for span in file.spans:
        try:
            messages = file.span_messages(span)
        except BagError as error:
            recovery.bad_chunks += 1
            recovery.lost_bytes += span.length
            recovery.remarks.append(f'{error}; the chunk was left out')
            continue
        recovery.chunks += 1
        numbers: dict[int, int] = {}
        for message in messages:
            if message.channel not in file.channels:
                unnamed += 1
                continue
            if message.channel not in numbers:
                numbers[message.channel] = _topic(file, message.channel, writer, topics)
            writer.write(numbers[message.channel], message.log_time, message.publish_time,
                         bytes(message.data))
    if unnamed:
        recovery.remarks.append(
            f'{file.path.name}: {unnamed} messages were left out, their topic is not known')
    # a topic without messages is worth keeping too
    for channel in file.channels:
        _topic(file, channel, writer, topics)


def _topic(file: McapFile, channel: int, writer: BagWriter, topics: Topics) -> int:
    entry = file.channels[channel]
    told = file.schemas.get(entry.schema_id)
    schema = Schema(
        told.name if told else '', told.encoding if told else '',
        told.data.decode('utf-8', 'replace') if told else '',
        entry.metadata.get('topic_type_hash', ''))
    encoding = entry.message_encoding or ENCODING
    number = topics.get((entry.topic, schema, encoding))
    if number is None:
        try:
            qos = qos_from_text(entry.metadata.get('offered_qos_profiles', ''))
        except BagError:
            # the messages are worth more than the QoS
            qos = []
        number = topics[entry.topic, schema, encoding] = writer.add_topic(
            entry.topic, schema.type_name, qos, schema=schema, encoding=encoding)
    return number


def _custom_data(files: list[McapFile], told: list[BagMetadata]) -> dict[str, str]:
    """Return the origin of the run, and what came to it later, from all that still have it."""
    data: dict[str, str] = {}
    for file in files:
        data.update(file.metadata.get(PROVENANCE_RECORD, {}))
    for metadata in told:
        data.update(metadata.custom_data)
    return data
