# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Make a bag that was cut off whole: every whole chunk, with index and `metadata.yaml`."""
from __future__ import annotations

import dataclasses
from pathlib import Path

from bags.compression import COMPRESSIONS
from bags.errors import BagError
from bags.mcap_file import ENCODING, McapFile
from bags.metadata import FILE_NAME
from bags.qos_text import qos_from_text
from bags.reader import data_files
from bags.salvage import open_damaged
from bags.schemas import Schema
from bags.writer import BagWriter, PROVENANCE_RECORD, ROSBAG2_RECORD
from msgs_bridge.yaml_text import load_yaml


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
        BagError: nothing can be read of the source, or the target exists.
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
                if not file.complete:
                    recovery.lost_bytes += lost
                    recovery.remarks.append(
                        f'{path.name}: {file.problem}; {lost} bytes were lost')
            except BagError as error:
                recovery.lost_bytes += path.stat().st_size
                recovery.remarks.append(f'{error}; nothing of it could be saved')
        if not files:
            raise BagError(recovery.remarks[0])
        if source.is_dir() and not (source / FILE_NAME).exists():
            recovery.remarks.append(f'there was no {FILE_NAME}')
        _copy(files, Path(target), recovery)
    finally:
        for file in files:
            file.close()
    return recovery


def _copy(files: list[McapFile], target: Path, recovery: Recovery) -> None:
    compression = next((span.compression for file in files for span in file.spans), '')
    names = {name: kind for kind, name in COMPRESSIONS.items()}
    with BagWriter(
        target, compression=names.get(compression, 'zstd'), custom_data=_custom_data(files),
    ) as writer:
        topics: dict[tuple[str, str], int] = {}
        for number, file in enumerate(files):
            if number:
                writer.next_file()
            _copy_file(file, writer, topics, recovery)
        recovery.messages = writer.message_count


def _copy_file(
    file: McapFile, writer: BagWriter, topics: dict[tuple[str, str], int], recovery: Recovery,
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
        for message in messages:
            if message.channel not in file.channels:
                unnamed += 1
                continue
            writer.write(
                _topic(file, message.channel, writer, topics), message.log_time,
                message.publish_time, bytes(message.data))
    if unnamed:
        recovery.remarks.append(
            f'{file.path.name}: {unnamed} messages were left out, their topic is not known')
    # a topic without messages is worth keeping too
    for channel in file.channels:
        _topic(file, channel, writer, topics)


def _topic(
    file: McapFile, channel: int, writer: BagWriter, topics: dict[tuple[str, str], int],
) -> int:
    entry = file.channels[channel]
    schema = file.schemas.get(entry.schema_id)
    type_name = schema.name if schema else ''
    number = topics.get((entry.topic, type_name))
    if number is None:
        text = schema.data.decode('utf-8', 'replace') if schema else ''
        try:
            qos = qos_from_text(entry.metadata.get('offered_qos_profiles', ''))
        except BagError:
            # the messages are worth more than the QoS
            qos = []
        number = topics[entry.topic, type_name] = writer.add_topic(
            entry.topic, type_name, qos,
            schema=Schema(type_name, schema.encoding if schema else '', text,
                          entry.metadata.get('topic_type_hash', '')),
            encoding=entry.message_encoding or ENCODING)
    return number


def _custom_data(files: list[McapFile]) -> dict[str, str]:
    """Return the origin of the run, from whichever record still has it."""
    for file in files:
        if PROVENANCE_RECORD in file.metadata:
            return file.metadata[PROVENANCE_RECORD]
        text = file.metadata.get(ROSBAG2_RECORD, {}).get('serialized_metadata', '')
        try:
            body = load_yaml(text, 'the rosbag2 record', BagError)
        except BagError:
            continue
        data = body.get('custom_data') if isinstance(body, dict) else None
        if isinstance(data, dict):
            return {str(key): str(value) for key, value in data.items()}
    return {}
