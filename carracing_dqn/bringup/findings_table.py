# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Findings as a table in the terminal."""
from __future__ import annotations

from collections.abc import Sequence

from carracing_dqn.simulation.fit import BAD, Finding, UNSURE
from msgs_bridge.plain_text import plain
from msgs_bridge.terminal import LINE
from rich.table import Table
from rich.text import Text

COLOURS = {BAD: 'red', UNSURE: 'yellow'}


def findings_table(found: Sequence[Finding]) -> Table:
    """Return a row a finding: what was looked at, the verdict, what was found, what mends it."""
    table = Table()
    for column in ('what', '', 'found', 'what mends it'):
        table.add_column(column, overflow='fold')
    for one in found:
        # texts of others stand in it: no markup, and nothing that a terminal obeys
        name, found, mend = (plain(text, LINE) for text in (one.name, one.found, one.mend))
        table.add_row(Text(name), Text(one.verdict, style=COLOURS.get(one.verdict, 'green')),
                      Text(found), Text(mend))
    return table
