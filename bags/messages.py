# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages and topics as every storage of a bag hands them out."""
from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
import dataclasses
from typing import Any, NamedTuple, Protocol

from bags.mcap_file import ENCODING, McapFile
from bags.schemas import Schema


class BagMessage(NamedTuple):
    """One message: its topic, log and publish time in ns, serialized bytes."""

    topic: str
    log_time: int
    publish_time: int
    data: memoryview | bytes


@dataclasses.dataclass
class BagTopic:
    """One topic of a bag; `message_count` is -1 when nothing in the file says it."""

    name: str
    type_name: str
    schema: Schema
    qos: list[dict[str, Any]]
    message_count: int = 0
    encoding: str = ENCODING


class Storage(Protocol):
    """
    What a storage of a bag offers; see `BagReader` for the meaning.

    `provenance` is what the files themselves say of the origin, `files` are the MCAP files.
    """

    topics: dict[str, BagTopic]
    start_time: int
    end_time: int
    message_count: int
    provenance: dict[str, str]
    files: Sequence[McapFile]

    def messages(
        self, names: Collection[str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield messages by log time."""

    def close(self) -> None:
        """Let go of the files."""
