# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages read ahead in a thread, so that unpacking a chunk delays no message."""
from __future__ import annotations

from collections.abc import Iterator
import queue
import threading

from bags.messages import BagMessage

# a chunk holds some hundred messages; two batches of this size wait at most
BATCH = 256
BATCH_BYTES = 16 << 20
WAITING = 2
# how often a reader that waits for room looks whether anybody still wants it; seconds
LOOK = 0.1


class ReadAhead:
    """Iterates over messages that a thread reads; an error of the reader is raised here."""

    def __init__(self, messages: Iterator[BagMessage]) -> None:
        """Start to read."""
        self._messages = messages
        self._queue: queue.Queue[list[BagMessage] | BaseException | None] = queue.Queue(WAITING)
        self._closed = False
        self._thread = threading.Thread(target=self._read, name='bag_reader', daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[BagMessage]:
        """
        Yield the messages.

        Raises:
            BagError: what the reader raised.
        """
        while (batch := self._queue.get()) is not None:
            if isinstance(batch, BaseException):
                raise batch
            yield from batch

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._thread.join()

    def _read(self) -> None:
        end: BaseException | None = None
        batch: list[BagMessage] = []
        size = 0
        try:
            for message in self._messages:
                batch.append(message)
                size += len(message.data)
                if len(batch) == BATCH or size >= BATCH_BYTES:
                    if not self._put(batch):
                        return
                    batch, size = [], 0
        except BaseException as error:
            end = error
        # what was read before an error comes first
        if self._put(batch):
            self._put(end)

    def _put(self, item: list[BagMessage] | BaseException | None) -> bool:
        while not self._closed:
            try:
                self._queue.put(item, timeout=LOOK)
                return True
            except queue.Full:
                continue
        return False
