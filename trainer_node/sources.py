# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The sources of a run: which there may be, by turns, and when they are held back.

One thread adds and removes them, another takes.
"""
from __future__ import annotations

from collections.abc import Iterable
import re

from msgs_bridge.errors import SettingsError
from msgs_bridge.plain_text import plain
from msgs_bridge.transitions import Transition
from trainer_node.source import Source

MOST = 128
"""Sources at a time; each has subscriptions and memory of its own."""

_PART = '[A-Za-z_*?][A-Za-z0-9_*?]*'
_NAME = re.compile(f'/?{_PART}(/{_PART})*')
_WILD = re.compile(r'[*?]')
_LONGEST = 200


class SourceNames:
    """
    Which sources a parameter asks for: names of namespaces, or patterns of them.

    Attributes:
        given: those named in full, absolute.
    """

    def __init__(self, text: str, namespace: str) -> None:
        """
        Read names and patterns (`*` any letters, `?` one), separated by commas.

        Args:
            text: `/car_*, /truck`; one without a slash at its front is below `namespace`.
            namespace: of the trainer.

        Raises:
            SettingsError: what is neither.
        """
        wanted = []
        for one in (part.strip() for part in text.split(',') if text.strip()):
            if len(one) > _LONGEST or not _NAME.fullmatch(one):
                raise SettingsError(
                    f'sources has {plain(one)!r}; accepted: namespaces such as /car_1, or '
                    'patterns of them such as /car_*, separated by commas')
            wanted.append(one if one.startswith('/') else f'{namespace.rstrip("/")}/{one}')
        # what is named twice is one car, of which everything would be learned twice
        wanted = list(dict.fromkeys(wanted))
        if len(wanted) > MOST:
            raise SettingsError(f'sources has {len(wanted)} names; accepted: up to {MOST}')
        self.given = tuple(one for one in wanted if not _WILD.search(one))
        self._patterns = [
            re.compile(one.replace('*', '[^/]*').replace('?', '[^/]'))
            for one in wanted if _WILD.search(one)]

    def __bool__(self) -> bool:
        """Return whether any are asked for."""
        return bool(self.given or self._patterns)

    def matching(self, namespaces: Iterable[str]) -> list[str]:
        """Return those namespaces that are meant by a pattern, in order."""
        return sorted(one for one in set(namespaces) if len(one) <= _LONGEST and any(
            pattern.fullmatch(one) for pattern in self._patterns))


class Sources:
    """All sources of the moment, in a tuple that is replaced as a whole."""

    def __init__(self, queue_limit: int) -> None:
        """Hold all of them back when more than `queue_limit` transitions wait together."""
        self._queue_limit = queue_limit
        self.all: tuple[Source, ...] = ()
        self._turn = 0

    def add(self, name: str) -> Source:
        """Return a new source."""
        source = Source(self._queue_limit, name)
        self.all = (*self.all, source)
        return source

    def remove(self, source: Source) -> None:
        """Take from a source no more; what waits of it is dropped."""
        self.all = tuple(one for one in self.all if one is not source)

    def take(self) -> tuple[Transition, str] | None:
        """Return the next transition and the name of its source, by turns; None if none waits."""
        every = self.all
        for _ in every:
            self._turn = (self._turn + 1) % len(every)
            source = every[self._turn]
            transition = source.take()
            if transition is not None:
                return transition, source.name
        return None

    def should_hold(self, holding: bool) -> bool:
        """Return whether all are to be held back; `holding` says whether they are now."""
        limit = self._queue_limit // 4 if holding else self._queue_limit
        return sum(map(len, self.all)) > limit
