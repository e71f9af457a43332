# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""sqlite3 bags, as rosbag2 wrote them before MCAP."""
from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
import contextlib
import os
from pathlib import Path
import sqlite3
from urllib.parse import quote

from bags.compression import unpack_message
from bags.errors import BagError
from bags.qos_text import qos_from_text
from bags.messages import BagMessage, BagTopic
from bags.schemas import Schema, schema_of
from msgs_bridge.plain_text import plain

# the last time that a database can hold
LAST_TIME = 2 ** 63 - 1
# of so many faults of its structure sqlite3 tells
MOST_DAMAGE = 20
# characters of what sqlite3 says
LINE = 300


class SqliteStorage:
    """The sqlite3 files of a bag; they hold no publish times, so log times stand for them."""

    def __init__(self, paths: Sequence[Path], *, packed: bool) -> None:
        """
        Look at the files, one after another.

        Args:
            paths: the files.
            packed: whether each message is packed by itself.

        Raises:
            BagError: one is no database, or not one that rosbag2 writes.
        """
        self._files: list[_SqliteFile] = []
        self.provenance: dict[str, str] = {}
        self.files: tuple[()] = ()
        self.topics: dict[str, BagTopic] = {}
        for path in paths:
            file = _SqliteFile(path, packed)
            self._files.append(file)
            self._learn_topics(file)
        times = [time for file in self._files for time in file.times]
        self.start_time, self.end_time = min(times, default=0), max(times, default=0)
        self._files.sort(key=lambda file: min(file.times, default=LAST_TIME))
        self.message_count = sum(topic.message_count for topic in self.topics.values())

    def messages(
        self, names: Collection[str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield messages by log time, file after file as rosbag2 does."""
        for file in self._files:
            yield from file.messages(names, start, stop)

    def damage(self) -> list[str]:
        """Read everything; return what is wrong with it, each a sentence."""
        return [f'{file.path.name}: {plain(problem, LINE)}'
                for file in self._files for problem in file.damage()]

    def close(self) -> None:
        """Do nothing: a file is open only while it is read."""

    def _learn_topics(self, file: _SqliteFile) -> None:
        for topic in file.topics:
            known = self.topics.setdefault(topic.name, topic)
            if known is topic:
                continue
            if known.type_name != topic.type_name:
                raise BagError(f'{file.path}: {topic.name} is of type {topic.type_name} and of '
                               f'type {known.type_name}')
            known.message_count += topic.message_count


class _SqliteFile:
    """One database: its topics, and the first and last log time of each that has messages."""

    def __init__(self, path: Path, packed: bool) -> None:
        self.path = path
        self._packed = packed
        self.topics: list[BagTopic] = []
        self.times: list[int] = []
        self._names: dict[int, str] = {}
        self._status: os.stat_result | None = None
        with self._opened() as base:
            self._learn(base)

    def messages(
        self, names: Collection[str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield messages by log time."""
        numbers = [number for number, name in self._names.items() if name in names]
        if not numbers or not self.times or max(self.times) < start or min(self.times) >= stop:
            return
        with self._opened() as base:
            for number, time, data in base.execute(
                    'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN '
                    f'({",".join("?" * len(numbers))}) AND timestamp BETWEEN ? AND ? '
                    'ORDER BY timestamp, id',
                    (*numbers, min(start, LAST_TIME), min(stop - 1, LAST_TIME))):
                yield BagMessage(
                    self._names[number], time, time,
                    self._unpacked(time, data) if self._packed else data)

    def damage(self) -> list[str]:
        """Return what sqlite3 finds wrong, and the first message that cannot be read."""
        found = []
        try:
            with self._opened() as base:
                found += [str(told) for told, in base.execute(
                    f'PRAGMA integrity_check({MOST_DAMAGE})') if told != 'ok']
            for _ in self.messages(self._names.values(), 0, 2 ** 64):
                pass
        except BagError as error:
            found.append(str(error).removeprefix(f'{self.path}: '))
        return found

    def _unpacked(self, time: int, data: bytes) -> bytes:
        try:
            return unpack_message(data)
        except BagError as error:
            raise BagError(f'{self.path}, message of {time} ns: {error}') from None

    def _refuse_programs(self, base: sqlite3.Connection) -> None:
        """
        Refuse what computes when it is read: a view in place of a table may never end.

        Raises:
            BagError: the file has something other than plain tables and indexes.
        """
        path, names = self.path, []
        for kind, name, text in base.execute('SELECT type, name, sql FROM sqlite_master'):
            if kind not in ('table', 'index') or str(text).upper().startswith('CREATE VIRTUAL'):
                raise BagError(f'{path} has the {kind} {plain(name)}; accepted: plain tables')
            names += [name] if kind == 'table' else []
        for name in names:
            hidden = base.execute('SELECT 1 FROM pragma_table_xinfo(?) WHERE hidden', (name,))
            if hidden.fetchone():
                raise BagError(f'{path}: the table {plain(name)} has computed columns')

    def _learn(self, base: sqlite3.Connection) -> None:
        """
        Read the topics, and count and check what there is of them.

        Raises:
            BagError: texts, times or data that are none, or messages of no topic.
        """
        counts = {}
        for number, count, first, last, odd in base.execute(
                "SELECT topic_id, count(*), min(timestamp), max(timestamp), sum(typeof(timestamp) "
                "!= 'integer' OR typeof(data) != 'blob') FROM messages GROUP BY topic_id"):
            if odd or first < 0:
                raise BagError(f'{self.path} has messages whose data are no bytes, or whose time '
                               'is no whole number from 0')
            counts[number] = count
            self.times += first, last
        columns = {row[1] for row in base.execute('PRAGMA table_info(topics)')}
        # older databases lack them
        qos, type_hash = (f"coalesce({name}, '')" if name in columns else "''"
                          for name in ('offered_qos_profiles', 'type_description_hash'))
        for number, *texts in base.execute(
                f'SELECT id, name, type, serialization_format, {qos}, {type_hash} FROM topics'):
            if not all(isinstance(text, str) for text in texts):
                raise BagError(f'{self.path} has a topic whose name, type, encoding, QoS or hash '
                               f'is no text: {plain(texts)}')
            name, type_name, encoding, qos_text, digest = texts
            known = schema_of(type_name)
            self._names[number] = name
            self.topics.append(BagTopic(
                name, type_name,
                Schema(type_name, known.encoding, known.text, digest or known.type_hash),
                qos_from_text(qos_text), counts.pop(number, 0), encoding))
        if counts:
            raise BagError(f'{self.path} has messages of topic {plain(min(counts, key=str))}, '
                           'which it never names')

    @contextlib.contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """
        Hold the database open: a bag may have more files than a process may have open.

        Raises:
            BagError: it is none that can be read, or it was replaced.
        """
        path = self.path
        # immutable: nothing is written beside it
        address = f'file:{quote(os.fsencode(path.resolve()))}?immutable=1&mode=ro'
        try:
            _refuse_unfinished(path)
            status = path.stat()
            if not os.path.samestat(status, self._status or status):
                raise BagError(f'{path} was replaced meanwhile')
            self._status = status
            # who reads ahead ends in another thread than the one that began
            with contextlib.closing(
                    sqlite3.connect(address, uri=True, check_same_thread=False)) as base:
                self._refuse_programs(base)
                yield base
        except (sqlite3.Error, OSError, OverflowError, MemoryError) as error:
            raise BagError(f'{self.path}: {plain(error, LINE)}') from None


def _refuse_unfinished(path: Path) -> None:
    """
    Refuse what a read-only look at the file alone would show without its newest messages.

    Raises:
        BagError: no regular file, or one that somebody writes or that was cut off.
    """
    if not path.is_file():
        raise BagError(f'{path} is not a regular file')
    for tail in ('-wal', '-journal'):
        # where the database itself lies, there sqlite3 puts it
        beside = Path(f'{path.resolve()}{tail}')
        if beside.is_file() and _is_pending(beside):
            raise BagError(
                f'{path} is being written or was cut off: there is {beside.name}; '
                f"`sqlite3 {path.name} 'SELECT count(*) FROM messages'` takes it in")


def _is_pending(journal: Path) -> bool:
    """Return whether a journal holds something; one that is done with is empty, or zeroed."""
    with journal.open('rb') as file:
        return file.read(1) not in (b'', b'\0')
