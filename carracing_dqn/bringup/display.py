# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Progress: a table that is redrawn on a terminal, plain lines otherwise."""
from __future__ import annotations

from collections.abc import Callable
import time

from carracing_dqn.bringup.monitor import GraphState
from rich.console import Console, RenderableType
from rich.live import Live

LINE_SECONDS = 10.0
"""Seconds between two plain lines."""


class Display:
    """
    Shows the state of a graph while it runs.

    A context manager; `update` is cheap and may be called often.
    """

    def __init__(
        self, state: GraphState, table: Callable[[GraphState], RenderableType],
        line: Callable[[GraphState], str], console: Console | None = None,
    ) -> None:
        """Show `table(state)` on a terminal, or `line(state)` now and then elsewhere."""
        self._state, self._table, self._line = state, table, line
        self.console = console or Console()
        self._live: Live | None = None
        self._next_line = 0.0
        self._episodes_shown = 0

    def __enter__(self) -> Display:
        if self.console.is_terminal:
            self._live = Live(console=self.console, refresh_per_second=4, transient=False)
            self._live.__enter__()
        return self

    def __exit__(self, *details: object) -> None:
        if self._live is not None:
            self._live.update(self._table(self._state))
            self._live.__exit__(*details)

    def update(self) -> None:
        """Show the present state."""
        if self._live is not None:
            self._live.update(self._table(self._state))
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + LINE_SECONDS
            self.console.print(self._line(self._state), highlight=False)
