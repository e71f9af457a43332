# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The records of an MCAP file, as bytes: what the specification calls op codes and layouts.

Only what is needed at every message is written here with `struct`; the rare records are made and
read by the `mcap` library. Specification: mcap.dev/spec.
"""
from __future__ import annotations

import io
import struct
from typing import Any

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel, ChunkIndex, DataEnd, Footer, Header, McapRecord, Metadata, MetadataIndex, Schema,
    Statistics,
)

from bags.errors import BagError

MAGIC = b'\x89MCAP0\r\n'
PROFILE = 'ros2'
LIBRARY = 'carracing_dqn'
# op code and length, before every record
HEAD = struct.Struct('<BQ')
# channel, sequence, log time, publish time: the start of a message record
MESSAGE = struct.Struct('<HIQQ')
# op code, length, and the start of a message record, in one go
MESSAGE_HEAD = struct.Struct('<BQHIQQ')
# first and last log time, unpacked size, CRC of the unpacked bytes: the start of a chunk record
CHUNK = struct.Struct('<QQQI')
INDEX_HEAD = struct.Struct('<BQHI')
FOOTER_BYTES = HEAD.size + 20

# A damaged or hostile length must not make us allocate what it says.
MAX_CHUNK = 256 << 20
MAX_RECORD = 64 << 20

READABLE = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex, Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.DATA_END: DataEnd,
}


def record_bytes(record: McapRecord) -> bytes:
    """Return a record of the `mcap` library as bytes."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def parse_record(opcode: int, content: Any) -> McapRecord | None:
    """
    Return the record of an op code, or None for one that is not needed here.

    Raises:
        BagError: the content does not hold what its op code says.
    """
    kind = READABLE.get(opcode)
    if kind is None:
        return None
    if len(content) > MAX_RECORD:
        raise BagError(f'{kind.__name__} record of {len(content)} bytes; accepted: {MAX_RECORD}')
    content = bytes(content)
    try:
        return kind.read(ReadDataStream(io.BytesIO(content)))
    except Exception as error:
        # the library raises whatever its parsing ran into
        raise BagError(f'{kind.__name__} record is damaged: {error!r}') from None
