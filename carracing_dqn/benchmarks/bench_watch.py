# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What `carracing watch` takes off a lockstep run that it looks on at."""
from __future__ import annotations

import argparse
import json
from pathlib import Path
import subprocess
import sys

from carracing_dqn.benchmarks.listener_cost import listener_cost
from msgs_bridge.terminal import say
from rich.console import Console

# until it has found the graph, seen that it is well, and subscribed
JOIN_SECONDS = 8.0


def main(words: list[str]) -> int:
    """Measure, print a line, and write the figures if asked to."""
    parser = argparse.ArgumentParser(prog='carracing bench watch', description=__doc__)
    parser.add_argument('--rounds', type=int, default=8, help='how often it comes and goes')
    parser.add_argument('--seconds', type=float, default=4.0, help='of one measurement')
    parser.add_argument('--json', default=None, help='file for the figures')
    options = parser.parse_args(words)
    if options.rounds < 2:
        parser.error('--rounds must be at least 2, or there is no error to state')
    figures = listener_cost(_begin, rounds=options.rounds, seconds=options.seconds,
                            settle=JOIN_SECONDS)
    say(Console(), f'lockstep while it is watched {figures["decisions_per_second_with"]:.0f} '
        f'decisions/s, otherwise {figures["decisions_per_second_without"]:.0f}: it takes '
        f'{figures["cost_percent"]:.1f} ± {figures["cost_percent_error"]:.1f} %, '
        f'{figures["cpu_percent"]:.1f} % of a core')
    if options.json:
        Path(options.json).write_text(json.dumps(figures, indent=2) + '\n', encoding='utf-8')
    return 0


def _begin(_: int) -> subprocess.Popen:
    """Start a watch that serves its page."""
    return subprocess.Popen(
        [sys.executable, '-m', 'carracing_dqn.bringup', 'watch', '--browser', '--port', '0'],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
