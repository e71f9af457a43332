# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What came of one fault."""
from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class Outcome:
    """
    One fault that was tried.

    Attributes:
        group: which table it is from: message, process, command or file.
        fault: its kind.
        where: topic, node, command or file.
        seed: what makes it again.
        problems: what was not as it must be; empty when it was survived.
        seconds: until the graph was as before, or until the command had ended; None for never.
        said: what was said of it, by a node's diagnostics or by a command's last line.
    """

    group: str
    fault: str
    where: str
    seed: int
    problems: list[str] = dataclasses.field(default_factory=list)
    seconds: float | None = None
    said: str = ''

    @property
    def survived(self) -> bool:
        """Return whether everything was as it must be."""
        return not self.problems

    def line(self) -> str:
        """Return it as one line."""
        seconds = 'never' if self.seconds is None else f'{self.seconds:.1f} s'
        return (f'{self.group} {self.fault} {self.where} (seed {self.seed}): '
                f'{"survived" if self.survived else "; ".join(self.problems)} [{seconds}] '
                f'{self.said[:150]!r}')
