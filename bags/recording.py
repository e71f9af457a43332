# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages on their way from the middleware to a bag: a bounded cache and a writing thread."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import json
import threading
import time
from typing import Any

from bags.errors import BagError
from bags.writer import BagWriter

# the writing thread looks this often, so that a chunk's age is noticed in time; seconds
TICK = 0.1
# how often it looks whether the bag is still there; seconds
PLACE_SECONDS = 0.5
# key of `custom_data`: a JSON object, topic -> messages that the recorder knows it has lost
LOST_MESSAGES = 'lost_messages'

# log time and publish time in ns, topic number, bytes
Entry = tuple[int, int, int, bytes]


class Recording:
    """
    Writes a bag in a thread of its own.

    `put` never waits for the disk; `room` says how much still fits. After the disk failed `error`
    says so, and what is put is counted as lost.
    """

    def __init__(self, writer: BagWriter, cache_bytes: int) -> None:
        """Start the thread; about `cache_bytes` may wait for the disk."""
        self.writer = writer
        self.cache_bytes = cache_bytes
        self.lost = 0
        self.peak_bytes = 0
        self._waiting_bytes = 0
        self._batches: deque[tuple[list[Entry], int]] = deque()
        self._topics: list[tuple[str, str, list[dict[str, Any]]]] = []
        self._written_topics = 0
        self._offers: deque[tuple[int, list[dict[str, Any]]]] = deque()
        self._wake = threading.Event()
        self._stop = False
        self._reason: str | None = None
        self._moved = time.monotonic()
        self._look_at_place = self._moved + PLACE_SECONDS
        # what is put and what is given up must not pass each other uncounted
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name='bag_writer', daemon=True)
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Return what went wrong and what it has cost so far; None as long as all is well."""
        if self._reason is None:
            return None
        return (f'{self.writer.folder}: {self._reason}; {self.writer.message_count} messages '
                f'are in the bag, {self.writer.lost + self.lost} were lost')

    @property
    def room(self) -> int:
        """Return how many bytes the cache still takes; one message fits into an empty one."""
        return self.cache_bytes - self._waiting_bytes

    @property
    def stalled_seconds(self) -> float:
        """Return for how long the disk has taken nothing although something waits for it."""
        return 0.0 if not self._waiting_bytes else time.monotonic() - self._moved

    def add_topic(self, name: str, type_name: str, qos: list[dict[str, Any]]) -> int:
        """Announce a topic; return the number its messages carry."""
        self._topics.append((name, type_name, qos))
        self._wake.set()
        return len(self._topics) - 1

    def add_offers(self, topic: int, qos: list[dict[str, Any]]) -> None:
        """Replace the profiles of a topic's publishers: others have come."""
        self._offers.append((topic, qos))

    def put(self, batch: list[Entry]) -> None:
        """Take messages in order."""
        size = sum(len(message[3]) for message in batch)
        with self._lock:
            if self._reason is not None:
                self.lost += len(batch)
                return
            if self._waiting_bytes == 0:
                self._moved = time.monotonic()
            self._waiting_bytes += size
            self.peak_bytes = max(self.peak_bytes, self._waiting_bytes)
            self._batches.append((batch, size))
        self._wake.set()

    def close(self, lost: Mapping[str, int] | None = None) -> None:
        """
        Write what is waiting and complete the bag.

        Args:
            lost: topic -> messages that never came here, for the bag's own metadata.

        Raises:
            BagError: the disk failed; the text says what was lost.
        """
        self._stop = True
        self._wake.set()
        self._thread.join()
        try:
            self._follow_topics()
            if lost is not None:
                self.writer.note(LOST_MESSAGES, json.dumps(dict(lost)))
            self.writer.close()
        except OSError as error:
            self._fail(error)
        if self.error is not None:
            raise BagError(self.error)

    def _run(self) -> None:
        try:
            while True:
                self._wake.wait(TICK)
                stop = self._stop
                self._wake.clear()
                self._follow_topics()
                while self._batches:
                    self._write(*self._batches.popleft())
                self.writer.tick()
                self._check_place()
                if stop:
                    return
        except Exception as error:
            # whatever it was, a thread that ends unseen would lose everything that follows
            self._fail(error)

    def _write(self, batch: list[Entry], size: int) -> None:
        write = self.writer.write
        # a topic is always announced before its first message
        self._follow_topics()
        done = 0
        try:
            for log_time, publish_time, topic, data in batch:
                write(topic, log_time, publish_time, data)
                done += 1
            # a flood must not keep it from being noticed that the bag is gone
            self._check_place()
        except OSError:
            # the message that met the failure was in the chunk that the writer counted
            self.lost += max(0, len(batch) - done - 1)
            raise
        finally:
            with self._lock:
                self._waiting_bytes -= size
                self._moved = time.monotonic()

    def _check_place(self) -> None:
        now = time.monotonic()
        if now >= self._look_at_place:
            self._look_at_place = now + PLACE_SECONDS
            self.writer.check_place()

    def _follow_topics(self) -> None:
        while self._written_topics < len(self._topics):
            self.writer.add_topic(*self._topics[self._written_topics])
            self._written_topics += 1
        while self._offers:
            self.writer.add_offers(*self._offers.popleft())

    def _fail(self, error: Exception) -> None:
        with self._lock:
            self.lost += sum(len(batch) for batch, _ in self._batches)
            self._batches.clear()
            self._waiting_bytes = 0
            self._reason = getattr(error, 'strerror', None) or str(error)
