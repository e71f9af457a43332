# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What those who show a watch know of where it comes from."""
from __future__ import annotations

from collections.abc import Collection
from typing import Any, Protocol

from carracing_dqn.watch.state import WatchState


class Source(Protocol):
    """
    A live graph or a bag.

    Attributes:
        state: what is known.
        commands: names of what can be done.
    """

    state: WatchState
    commands: Collection[str]

    def now(self) -> float:
        """Return the time that `state` goes by; seconds."""

    def act(self, name: str, value: Any = None, namespace: str | None = None) -> None:
        """
        Do something by name; the answer comes in `state.notice`.

        Raises:
            BridgeError: there is no such command, or the value is none for it.
        """

    def close(self) -> None:
        """End."""
