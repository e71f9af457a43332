# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sqlite3 bags, as rosbag2 wrote them before MCAP, read by the `rosbags` library."""
from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
import contextlib
from pathlib import Path
import sqlite3
from typing import Any
from urllib.parse import quote

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9

from bags.errors import BagError
from bags.qos_text import normalize_qos
from bags.messages import BagMessage, BagTopic
from bags.schemas import Schema, schema_of
from msgs_bridge.plain_text import plain


class SqliteStorage:
    """A sqlite3 bag; it holds no publish times, so log times stand for them."""

    def __init__(self, path: Path, files: Sequence[Path]) -> None:
        """
        Open a bag of one or more files.

        Raises:
            BagError: the library cannot read it.
        """
        self._reader = _guard(path, lambda: _opened(path, files))
        self.provenance: dict[str, str] = {}
        self.files: tuple[()] = ()
        self.path = path
        reader = self._reader
        self.topics: dict[str, BagTopic] = {}
        for connection in reader.connections:
            known = schema_of(connection.msgtype)
            self.topics[connection.topic] = BagTopic(
                connection.topic, connection.msgtype,
                Schema(connection.msgtype, known.encoding, known.text,
                       connection.digest or known.type_hash),
                normalize_qos(dump_qos_v9(connection.ext.offered_qos_profiles)),
                connection.msgcount, connection.ext.serialization_format)
        self.message_count = reader.message_count
        self.start_time = reader.start_time if self.message_count else 0
        # the library gives the first time that is outside
        self.end_time = reader.end_time - 1 if self.message_count else 0

    def messages(
        self, names: Collection[str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield messages by log time."""
        connections = [one for one in self._reader.connections if one.topic in names]
        if not connections:
            return
        stream = self._reader.messages(connections, start, min(stop, 2 ** 63 - 1))
        while True:
            item = _guard(self.path, lambda: next(stream, None))
            if item is None:
                return
            connection, time, data = item
            yield BagMessage(connection.topic, time, time, data)

    def close(self) -> None:
        """Let go of the files."""
        self._reader.close()


def _opened(path: Path, files: Sequence[Path]) -> Reader:
    for file in files:
        _refuse_programs(file)
    reader = Reader(path)
    reader.open()
    return reader


def _refuse_programs(path: Path) -> None:
    """
    Refuse what computes when it is read: a view in place of a table may never end.

    Raises:
        BagError: the file has something other than plain tables and indexes.
    """
    if not path.is_file():
        raise BagError(f'{path} is not a regular file')
    address = f'file:{quote(str(path.resolve()))}?immutable=1&mode=ro'
    with contextlib.closing(sqlite3.connect(address, uri=True)) as base:
        names = []
        for kind, name, text in base.execute('SELECT type, name, sql FROM sqlite_master'):
            if kind not in ('table', 'index') or str(text).upper().startswith('CREATE VIRTUAL'):
                raise BagError(f'{path} has the {kind} {plain(name)}; accepted: plain tables')
            names += [name] if kind == 'table' else []
        for name in names:
            hidden = base.execute('SELECT 1 FROM pragma_table_xinfo(?) WHERE hidden', (name,))
            if hidden.fetchone():
                raise BagError(f'{path}: the table {plain(name)} has computed columns')


def _guard(path: Path, act: Callable[[], Any]) -> Any:
    try:
        return act()
    except BagError:
        raise
    except Exception as error:
        # the library lets through whatever sqlite3, zstd or its own parsing raise
        raise BagError(f'{path}: {error}') from None
