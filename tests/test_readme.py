# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""README and the pages say what the code says."""
from pathlib import Path
import re

from carracing_dqn.bringup.command import SUBCOMMANDS
from carracing_dqn.bringup.environment import executables
from carracing_dqn.bringup.graph import KINDS
from carracing_dqn.bringup.reference_tables import SETTINGS, with_tables

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / 'README.md').read_text(encoding='utf-8')
PAGES = (ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md')))


def test_the_tables_are_those_of_the_code():
    for page in PAGES:
        text = page.read_text(encoding='utf-8')
        assert with_tables(text) == text, (
            f'run python -m carracing_dqn.bringup.reference_tables {page.relative_to(ROOT)}')
    pages = ''.join(page.read_text(encoding='utf-8') for page in PAGES)
    for name in ('topics', *SETTINGS):
        assert f'<!-- table: {name} -->' in pages
    for name in ('topics', *(kind.name for kind in KINDS)):
        assert f'<!-- table: {name} -->' in README


def test_every_command_and_node_is_named():
    for name in (*SUBCOMMANDS, *executables()):
        assert name in README, name


def test_the_files_that_are_linked_are_there():
    for page in PAGES:
        for target in re.findall(r'\]\(([^)#:]+)\)', page.read_text(encoding='utf-8')):
            assert (page.parent / target).exists(), f'{page.name}: {target}'
