# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a graph consists of, as plain values: nodes, topics, their ends and what does not fit."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
import dataclasses
from typing import NamedTuple

from msgs_bridge.health import ERROR, Health, OK

# values of a node that change as long as it gets on with its work
PROGRESS = ('decisions', 'transitions_joined')
# the time over which a rate is taken; seconds
RATE_SECONDS = 3.0


class End(NamedTuple):
    """
    A publisher or a subscription.

    Attributes:
        node: full name.
        type_name: of the messages.
        qos: in words.
        reliable: whether it offers or asks for reliable delivery.
    """

    node: str
    type_name: str
    qos: str
    reliable: bool = True


class Misfit(NamedTuple):
    """A publisher and a subscription between which nothing flows, and why: 'type' or 'QoS'."""

    kind: str
    publisher: str
    subscription: str
    reason: str


class TopicEnds(NamedTuple):
    """Who publishes a topic and who subscribes to it, as the graph says at the moment."""

    type_name: str
    publishers: Sequence[End] = ()
    subscriptions: Sequence[End] = ()
    misfits: Sequence[Misfit] = ()


@dataclasses.dataclass
class Node:
    """
    A node: what the graph and what it itself says.

    Attributes:
        name: full name.
        since: when it was first seen or heard; seconds.
        listed_at: when the graph last had it.
        heard_at: when it last spoke on `/diagnostics`, None if never.
        level, summary, values: what it said then.
        worst: the newest summary at level ERROR, '' if there was none.
        was_ok: whether it has ever said that all is well.
        progress_at: when one of the values of `PROGRESS` last changed.
    """

    name: str
    since: float
    listed_at: float | None = None
    heard_at: float | None = None
    level: int = 0
    summary: str = ''
    values: Mapping[str, str] = dataclasses.field(default_factory=dict)
    worst: str = ''
    was_ok: bool = False
    progress_at: float = 0.0

    @property
    def is_policy(self) -> bool:
        """Return whether it speaks as a policy does."""
        return 'weights_version' in self.values and 'sequences' in self.values

    @property
    def is_simulator(self) -> bool:
        """Return whether it speaks as a simulator does."""
        return 'decisions_per_second' in self.values and 'simulator' in self.values

    @property
    def is_trainer(self) -> bool:
        """Return whether it speaks as a trainer does."""
        return 'progress' in self.values and 'weights_version' in self.values

    def hear(self, said: Health, now: float) -> None:
        """Take what it says of itself."""
        if any(said.values.get(name) != self.values.get(name) for name in PROGRESS):
            self.progress_at = now
        self.heard_at = now
        self.level, self.summary, self.values = said.level, said.summary, said.values
        self.was_ok |= said.level == OK
        if said.level in (OK, ERROR):
            self.worst = said.summary if said.level == ERROR else ''

    def number(self, name: str) -> float | None:
        """Return one of its values as a number, None if it is none."""
        try:
            return float(self.values[name])
        except (KeyError, ValueError):
            return None


class Topic:
    """
    A topic: its ends, and how often something comes.

    Attributes:
        name: full name.
        ends: see `TopicEnds`.
        taken: messages that were taken; others may have been passed over.
        heard_at: when the last came; seconds, None if never.
        size: bytes of the last.
    """

    def __init__(self, name: str, ends: TopicEnds) -> None:
        """Begin without messages."""
        self.name, self.ends = name, ends
        self.taken = 0
        self.heard_at: float | None = None
        self.size = 0
        # (time, number of the message): its publisher's, or how many were taken
        self._marks: deque[tuple[float, int]] = deque(maxlen=1000)

    def came(self, at: float, size: int, sequence: int) -> None:
        """Note a message; `sequence` is its publisher's number, 0 if that is not known."""
        self.taken += 1
        self.heard_at, self.size = at, size
        if len(self.ends.publishers) > 1 or not sequence:
            sequence = self.taken
        if self._marks and sequence <= self._marks[-1][1]:
            # another publisher, or one that began anew
            self._marks.clear()
        self._marks.append((at, sequence))

    def rate(self, now: float) -> float | None:
        """Return messages a second lately, None where nothing ever came."""
        marks = self._marks
        while marks and now - marks[0][0] > RATE_SECONDS:
            marks.popleft()
        if self.heard_at is None:
            return None
        span = marks[-1][0] - marks[0][0] if marks else 0.0
        if span < 1.0:
            # too few to tell from their distance
            return len(marks) / RATE_SECONDS
        # up to now, so that one that has stopped falls
        return (marks[-1][1] - marks[0][1]) / max(span, now - marks[0][0] - 0.5)
