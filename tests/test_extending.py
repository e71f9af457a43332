# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Every example of docs/extending.md is done as it stands there, in a copy of the package."""
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys

from dqn_policy_node.settings import PolicySettings
from msgs_bridge.settings import describe, from_mapping
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'extending.md').read_text(encoding='utf-8')
BLOCKS = re.findall(r'^```(\w+)\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)
PACKAGES = ('msgs_bridge', 'carracing_sim_node', 'dqn_policy_node', 'trainer_node', 'bags',
            'carracing_dqn', 'config')
COMMANDS = [line for kind, text in BLOCKS if kind == 'sh' for line in text.splitlines()]


def put(folder, text):
    """Write a block where its first line says."""
    first, _, body = text.partition('\n')
    name, _, mark = first.removeprefix('# ').partition(', before: ')
    path = folder / name
    if not mark:
        assert not path.exists(), f'{name} is there already'
        path.write_text(text)
        return
    lines = path.read_text().splitlines(keepends=True)
    places = [number for number, line in enumerate(lines) if line.startswith(mark)]
    place = len(lines) if mark == '<end>' else places[0] if len(places) == 1 else None
    assert place is not None, f'{name} has {len(places)} lines that begin with {mark!r}'
    path.write_text(''.join([*lines[:place], body, *lines[place:]]))


@pytest.fixture(scope='module')
def extended(tmp_path_factory):
    """Return a copy of the package with every example in it."""
    folder = tmp_path_factory.mktemp('extended')
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns('__pycache__'))
    (folder / 'models').symlink_to(ROOT / 'models')
    for kind, text in BLOCKS:
        if kind in ('python', 'yaml'):
            put(folder, text)
    return folder


def call(folder, line):
    words = shlex.split(line)
    assert words[0] == 'carracing'
    return subprocess.run(
        [sys.executable, '-m', 'carracing_dqn.bringup', *words[1:]], cwd=folder,
        env={**os.environ, 'PYTHONPATH': str(folder)}, capture_output=True, text=True,
        timeout=300)


def test_every_command_of_the_page_works_in_its_order(extended):
    assert len(COMMANDS) >= 5
    said = {}
    for line in COMMANDS:
        done = call(extended, line)
        assert done.returncode == 0, f'{line}\n{done.stdout}\n{done.stderr}'
        said[line.split('--')[0].strip()] = done.stdout
    assert '0 differ' in said['carracing bag verify runs/dot/bag']
    for run in ('dot-live', 'dot-mine'):
        assert (extended / 'runs' / run / 'final' / 'weights.safetensors').is_file()
        assert 'loss' in (extended / 'runs' / run / 'updates.csv').read_text()
    config = (extended / 'runs' / 'dot-mine' / 'config.yaml').read_text()
    for value in ('turns3', 'log_cosh', 'munchausen', 'distance_penalty: 0.1'):
        assert value in config


def test_a_weight_whose_info_nobody_publishes_is_refused_by_name(extended):
    done = call(extended, 'carracing train --from-bag runs/dot/bag --preset dot.yaml '
                          '--run runs/refused --set speed_weight=1')
    assert done.returncode == 2 and "'speed'" in done.stderr, done.stdout + done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_adding_a_simulator_is_one_new_file_and_no_line():
    text = PAGE.split('## A simulator')[1].split('\n## ')[0]
    blocks = re.findall(r'^```python\n# (.*)$', text, re.MULTILINE)
    assert blocks == ['dot.py']


def test_the_parameters_of_the_robot_are_those_of_the_policy():
    text = next(text for kind, text in BLOCKS if text.startswith('# robot.yaml'))
    values = yaml.safe_load(text)['/**']['ros__parameters']
    known = describe(PolicySettings)
    settings = from_mapping(PolicySettings, {
        name: str(value) if known[name][0] is str else value for name, value in values.items()})
    assert settings.camera_turn == '180' and settings.linear_scale == 0.8
