# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""README says what the code says."""
from pathlib import Path
import re

from carracing_dqn.bringup.command import SUBCOMMANDS
from carracing_dqn.bringup.environment import executables
from carracing_dqn.bringup.reference_tables import SETTINGS, with_tables

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / 'README.md').read_text(encoding='utf-8')


def test_the_tables_are_those_of_the_code():
    assert with_tables(README) == README, (
        'run python -m carracing_dqn.bringup.reference_tables README.md')
    for name in ('topics', *SETTINGS):
        assert f'<!-- table: {name} -->' in README


def test_every_command_and_node_is_named():
    for name in (*SUBCOMMANDS, *executables()):
        assert name in README, name


def test_the_files_that_are_linked_are_there():
    for target in re.findall(r'\]\(([^)#:]+)\)', README):
        assert (ROOT / target).exists(), target
