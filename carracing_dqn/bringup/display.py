# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Progress: a table that is redrawn on a terminal, plain lines otherwise."""
from __future__ import annotations

from collections.abc import Callable
import time

from carracing_dqn.bringup.monitor import GraphState
from msgs_bridge.terminal import say
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
        self, state: GraphState, table: Callable[[GraphState, int], RenderableType],
        line: Callable[[GraphState], str], console: Console,
    ) -> None:
        """Show `table(state, rows of the terminal)`, or `line(state)` now and then elsewhere."""
        self._state, self._table, self._line = state, table, line
        self._console = console
        self._live: Live | None = None
        self._next_line = 0.0
        self._said = ''

    def __enter__(self) -> Display:
        # one that cannot move its cursor shows no table before the end
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=False)
            self._live.__enter__()
        return self

    def __exit__(self, *details: object) -> None:
        if self._live is not None:
            self._live.update(self._now())
            self._live.__exit__(*details)

    def update(self) -> None:
        """Show the present state."""
        if self._live is not None:
            self._live.update(self._now())
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + LINE_SECONDS
            self._say_state()

    def finish(self) -> None:
        """Show the last state where no table stands."""
        if self._live is None:
            self._say_state()

    @property
    def on_terminal(self) -> bool:
        """Return whether a person looks."""
        return self._console.is_terminal

    def say(self, text: str) -> None:
        """Print a line."""
        say(self._console, text)

    def _now(self) -> RenderableType:
        return self._table(self._state, self._console.height)

    def _say_state(self) -> None:
        line = self._line(self._state)
        # in a log, a line that says nothing new is one too many
        if line != self._said:
            self._said = line
            self.say(line)
