# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables of commands, topics, fields and settings in the documentation, made from the code.

`python -m carracing_dqn.bringup.reference_tables README.md docs/*.md` writes them anew between
their markers; a test holds the pages to them.
"""
from __future__ import annotations

from collections.abc import Sequence
import importlib
from pathlib import Path
import re
import sys

from carracing_dqn.bringup.command import SUBCOMMANDS
from carracing_dqn.bringup.graph import KINDS
from carracing_sim_node import info_fields
from msgs_bridge import step
from msgs_bridge.atomic_write import write_text
from msgs_bridge.settings import markdown_table
from msgs_bridge.topics import ROBOT_TOPICS, Topic, TOPICS, VIEW_TOPICS

SETTINGS = {
    'every_node': ('msgs_bridge.node_shell', 'ShellSettings'),
    'hyperparameters': ('trainer_node.hyperparameters', 'Hyperparameters'),
    'study': ('carracing_dqn.studies.study_file', 'StudySettings'),
    'search': ('carracing_dqn.studies.search', 'SearchSettings'),
    'gymnasium_env': ('carracing_dqn.simulators.gymnasium_env', 'GymnasiumEnvSettings'),
    **{kind.name: tuple(kind.settings.split(':')) for kind in KINDS}}
# name -> text
LISTS = {
    'commands': {f'carracing {name}': text for name, (_, text) in SUBCOMMANDS.items()},
    'step_core': step.STEP_CORE,
    'step_info': step.STEP_INFO,
    'episode_core': step.EPISODE_CORE,
    'q_value_extras': {**step.Q_VALUE_EXTRAS, **step.Q_VALUE_AXES},
    'validation': step.VALIDATION_FIELDS,
    'carracing_info': info_fields.STEP_INFO,
    'carracing_constants': info_fields.CONSTANTS,
}
TOPIC_TABLES = {'topics': TOPICS, 'robot_topics': ROBOT_TOPICS, 'view_topics': VIEW_TOPICS}
MARKED = re.compile(r'(<!-- table: (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def topics_table(topics: Sequence[Topic]) -> str:
    """Return topics as a Markdown table."""
    lines = ['| topic | type | from | QoS | content |', '|---|---|---|---|---|']
    for topic in topics:
        qos = 'reliable' if topic.reliable else 'best effort'
        if topic.latched:
            qos += ', transient local'
        lines.append(f'| `{topic.name}` | {topic.type_name.replace("/msg/", "/")} | '
                     f'{topic.publisher} | {qos}, depth {topic.depth} | {topic.text} |')
    return '\n'.join(lines)


def table(name: str) -> str:
    """Return the table of a marker: commands, topics, fields of a bundle, or settings."""
    if name in LISTS:
        rows = [f'| `{key}` | {text} |' for key, text in LISTS[name].items()]
        return '\n'.join(['| name | meaning |', '|---|---|', *rows])
    if name in TOPIC_TABLES:
        return topics_table(TOPIC_TABLES[name])
    module, settings = SETTINGS[name]
    found = getattr(importlib.import_module(module), settings)
    # the settings of a simulator node are those of the simulator, too, by default of CarRacing
    return markdown_table(found if isinstance(found, type) else found())


def with_tables(text: str) -> str:
    """Return a Markdown text with every marked table made anew."""
    return MARKED.sub(lambda found: f'{found[1]}{table(found[2])}\n{found[3]}', text)


if __name__ == '__main__':
    for path in map(Path, sys.argv[1:]):
        write_text(path, with_tables(path.read_text(encoding='utf-8')))
