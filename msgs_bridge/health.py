# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a node says of itself on `/diagnostics`, bounded and as plain text."""
from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from msgs_bridge.plain_text import plain

OK, WARN, ERROR = 0, 1, 2
LEVELS = ('ok', 'warn', 'error', 'stale')
# of one status; our own nodes say up to 60 values and 300 characters
MAX_VALUES = 128
SUMMARY_LENGTH = 300
# of one message; an aggregator says some hundred
MAX_STATUSES = 1000


class Health(NamedTuple):
    """The full name of a node, its level (0 OK, 1 WARN, 2 ERROR, 3 stale), summary and values."""

    node: str
    level: int
    summary: str
    values: dict[str, str]


def read_health(message: Any) -> Iterator[Health]:
    """Yield what stands in a DiagnosticArray."""
    for status in message.status[:MAX_STATUSES]:
        level = status.level
        # rclpy has an octet as bytes
        level = level[0] if isinstance(level, bytes) else int(level)
        yield Health(
            plain(status.name), min(level, len(LEVELS) - 1),
            plain(status.message, SUMMARY_LENGTH),
            {plain(pair.key): plain(pair.value) for pair in status.values[:MAX_VALUES]})
