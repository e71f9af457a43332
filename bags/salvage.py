# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What is whole in a damaged MCAP file, wherever it lies."""
from __future__ import annotations

from pathlib import Path
import re

from mcap.opcode import Opcode

from bags.errors import BagError
from bags.mcap_file import McapFile, Span
from bags.mcap_records import HEAD, parse_record, record_bytes

# how a chunk of less than 4 GiB begins, up to the name of its compression
CHUNK_BEGINS = re.compile(
    rb'\x06.{4}\x00{4}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd)', re.DOTALL)
# how a short schema, channel or metadata record begins
NAMES_BEGIN = re.compile(rb'[\x03\x04\x0c].{3}\x00{5}', re.DOTALL)
# bytes looked at in vain for each byte of the file: one made of such beginnings ends, too
EFFORT = 20
# a few seconds, which no file by accident needs
LEAST_EFFORT = 4 << 30


def open_damaged(path: Path | str) -> tuple[McapFile, int]:
    """
    Open a file with everything in it that is whole.

    Behind damage these are chunks whose CRC is right, and the names of topics. A chunk that is
    there twice is taken once.

    Returns:
        The file, and how many of its bytes belong to nothing that is whole.

    Raises:
        BagError: it cannot be read, or nothing of it is whole.
    """
    file = McapFile(path, strict=False)
    if file.complete and not file.damage and all(map(file.fits, file.spans)):
        return file, 0
    whole = [(0, file.whole_until), *_salvage(file), (file.size, file.size)]
    if not (file.library or file.spans or file.channels):
        file.close()
        raise BagError(f'{path} is not an MCAP file, or nothing of it is whole')
    lost = end = 0
    for start, stop in sorted(whole):
        lost += max(start - end, 0)
        end = max(end, stop)
    return file, 0 if file.complete else lost


def _salvage(file: McapFile) -> list[tuple[int, int]]:
    """Add to a file what is whole behind damage; return where it lies, as (start, end)."""
    chunks = {span.record: span for span in file.spans if span.crc and file.fits(span)}
    known = set(map(_content, chunks.values()))
    found, position, effort = [], 0, EFFORT * file.size + LEAST_EFFORT
    while match := CHUNK_BEGINS.search(file.raw(0, file.size), position):
        start = match.start()
        span = chunks.get(start)
        if span is None and effort > 0:
            span, cost = _whole_chunk(file, start)
            effort -= cost
        position = span.offset + span.length if span else start + 1
        if span is None or start in chunks:
            continue
        found.append((start, position))
        if _content(span) not in known:
            known.add(_content(span))
            file.spans.append(span)
    inside = sorted([
        *((span.record, span.offset + span.length) for span in chunks.values()), *found])
    return found + _names_between(file, inside)


def _content(span: Span) -> tuple[int, ...]:
    return span.start_time, span.end_time, span.crc, span.unpacked_size


def _whole_chunk(file: McapFile, position: int) -> tuple[Span | None, int]:
    """Return the chunk that begins at a byte, if its CRC says so, and the bytes looked at."""
    try:
        span = file.read_chunk(position + HEAD.size, file.size)
    except BagError:
        return None, 0
    if span.crc and file.fits(span):
        return span, 0
    return None, span.length + span.unpacked_size


def _names_between(
    file: McapFile, chunks: list[tuple[int, int]],
) -> list[tuple[int, int]]:
    """Take schemas, channels and metadata that lie between chunks; return where they lie."""
    found = []
    effort = EFFORT * file.size + LEAST_EFFORT
    bounds = [0, *(place for chunk in chunks for place in chunk), file.size]
    for low, high in zip(bounds[::2], bounds[1::2]):
        for match in NAMES_BEGIN.finditer(file.raw(0, file.size), low, high):
            head = match.start()
            opcode, length = HEAD.unpack(file.raw(head, head + HEAD.size))
            end = head + HEAD.size + length
            if end > file.size:
                continue
            effort -= length
            if effort < 0:
                return found
            content = file.raw(head + HEAD.size, end)
            try:
                record = parse_record(opcode, content)
                if bytes(record_bytes(record))[HEAD.size:] != content:
                    continue
            except (BagError, UnicodeError):
                continue
            if opcode == Opcode.METADATA:
                file.metadata.setdefault(record.name, record.metadata)
            else:
                known = file.schemas if opcode == Opcode.SCHEMA else file.channels
                known.setdefault(record.id, record)
            found.append((head, end))
    return found
