# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables of topics and parameters in README, made from where they are declared.

`python -m carracing_dqn.bringup.reference_tables README.md` writes them anew between
their markers; a test holds README to them.
"""
from __future__ import annotations

import importlib
from pathlib import Path
import re
import sys

from msgs_bridge.atomic_write import write_text
from msgs_bridge.settings import markdown_table
from msgs_bridge.topics import TOPICS

SETTINGS = {
    'carracing_sim_node': ('carracing_sim_node.settings', 'SimulatorSettings'),
    'dqn_policy_node': ('dqn_policy_node.settings', 'PolicySettings'),
    'trainer_node': ('trainer_node.settings', 'TrainerSettings'),
    'validation_node': ('carracing_dqn.evaluation.settings', 'ValidationSettings'),
    'bag_recorder_node': ('bags.settings', 'RecorderSettings'),
    'bag_player_node': ('bags.settings', 'PlayerSettings'),
}
MARKED = re.compile(r'(<!-- table: (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def topics_table() -> str:
    """Return the topic contract as a Markdown table."""
    lines = ['| topic | type | from | QoS | content |', '|---|---|---|---|---|']
    for topic in TOPICS:
        qos = 'reliable' if topic.reliable else 'best effort'
        if topic.latched:
            qos += ', transient local'
        lines.append(f'| `{topic.name}` | {topic.type_name.replace("/msg/", "/")} | '
                     f'{topic.publisher} | {qos}, depth {topic.depth} | {topic.text} |')
    return '\n'.join(lines)


def table(name: str) -> str:
    """Return the table of a marker: `topics`, or the parameters of a node."""
    if name == 'topics':
        return topics_table()
    module, settings = SETTINGS[name]
    return markdown_table(getattr(importlib.import_module(module), settings))


def with_tables(text: str) -> str:
    """Return a Markdown text with every marked table made anew."""
    return MARKED.sub(lambda found: f'{found[1]}{table(found[2])}\n{found[3]}', text)


if __name__ == '__main__':
    for path in map(Path, sys.argv[1:]):
        write_text(path, with_tables(path.read_text(encoding='utf-8')))
