# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag whose reading is shown on a terminal, for commands that take minutes of a long one."""
from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
import time

from bags.live_line import LiveLine
from bags.messages import BagMessage
from bags.reader import BagReader

SHOW_SECONDS = 0.2


class WatchedReader(BagReader):
    """A reader that shows how far it is, and nothing where there is no terminal."""

    def __init__(self, path: Path | str, first: str, then: str) -> None:
        """Open a bag; show what is done `first`, and what is done with its messages `then`."""
        super().__init__(path)
        self._line, self._then = LiveLine(), then
        self._show_at = 0.0
        self._line.show(first)

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[BagMessage]:
        """Yield messages as `BagReader.messages` does."""
        messages = super().messages(topics, start, stop)
        return self._watched(messages) if self._line.there else messages

    def _watched(self, messages: Iterator[BagMessage]) -> Iterator[BagMessage]:
        whole = max(self.end_time - self.start_time, 1)
        for message in messages:
            if time.monotonic() >= self._show_at:
                self._show_at = time.monotonic() + SHOW_SECONDS
                share = (message.log_time - self.start_time) / whole
                self._line.show(f'{self._then}: {share:.0%}')
            yield message

    def close(self) -> None:
        """Leave an empty line and let go of the bag."""
        self._line.close()
        super().close()
