# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Lines for a terminal that hold texts from outside."""
from __future__ import annotations

from msgs_bridge.plain_text import plain
from rich.console import Console
from rich.text import Text

# of a line that quotes texts from outside, paths for one
LINE = 1000


def say(console: Console, text: object) -> None:
    """Print one line as it is: nothing in it is markup, the name of an emoji or a colour."""
    console.print(Text(plain(text, LINE)), soft_wrap=True)
