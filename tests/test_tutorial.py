# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""docs/tutorial.md is typed as it stands there, in one shell, with fewer minutes of training."""
import json
from pathlib import Path
import re
import shlex
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'tutorial.md').read_text(encoding='utf-8')
BLOCKS = re.findall(r'^```(\w+)\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)
SHELL = [line for kind, text in BLOCKS if kind == 'sh' for line in text.splitlines()]
# the one thing that is not done as it is written
FEWER_MINUTES = ('--minutes 10', '--minutes 0.1')
# done already where the tests run; typing them again would ask a registry
DONE = ('make setup', 'pip install onnxruntime')
MARK = '==> '


@pytest.fixture(scope='module')
def typed(tmp_path_factory):
    """Type the page; return the folder, and for each line what it said and its exit code."""
    pytest.importorskip('onnx', reason='onnx is not installed')
    pytest.importorskip('onnxruntime', reason='onnxruntime is not installed')
    if not (Path(sys.prefix) / 'setup.bash').is_file():
        pytest.skip('the tests run outside of an environment of make setup')
    folder = tmp_path_factory.mktemp('clone')
    (folder / '.venv').symlink_to(sys.prefix)
    (folder / 'config').symlink_to(ROOT / 'config')
    for kind, text in BLOCKS:
        if kind == 'python':
            (folder / text.split()[1]).write_text(text)
    lines = [line.replace(*FEWER_MINUTES) for line in SHELL if line not in DONE]
    script = ''.join(f'echo {shlex.quote(MARK + line)}; {line} 2>&1; echo "{MARK}$?"\n'
                     for line in lines)
    done = subprocess.run(['bash', '-c', script], cwd=folder, capture_output=True, text=True,
                          timeout=900)
    parts = re.split(f'^{MARK}(.*)\n', done.stdout, flags=re.MULTILINE)[1:]
    said = {parts[place]: (int(parts[place + 2]), parts[place + 1])
            for place in range(0, len(parts), 4)}
    assert list(said) == lines, done.stdout + done.stderr
    return folder, said


def said_by(typed, beginning):
    return next(text for line, (_, text) in typed[1].items() if line.startswith(beginning))


def test_every_line_works(typed):
    assert not {line: told for line, told in typed[1].items() if told[0]}


def test_it_was_driven_recorded_and_drawn(typed):
    assert 'cmd_vel' in said_by(typed, 'carracing bag info runs/first/bag')
    assert (typed[0] / 'runs' / 'first' / 'pictures' / 'lap-420.png').is_file()
    assert 'image_raw' in said_by(typed, 'carracing bag info runs/pendulum/bag')


def test_the_recipe_that_was_changed_is_the_one_that_was_learned_by(typed):
    assert 'epsilon_decisions=30000' in said_by(typed, 'carracing train --preset mine.yaml --list')
    run = typed[0] / 'runs' / 'mine'
    assert 'epsilon_decisions: 30000' in (run / 'config.yaml').read_text()
    assert (run / 'final' / 'model.json').is_file()
    assert (run / 'report' / 'report.html').is_file()


def test_the_exported_model_drives_the_lap_that_was_evaluated(typed):
    laps = json.loads((typed[0] / 'runs' / 'mine' / 'evaluation.json').read_text())['laps']
    first = next(lap for lap in laps if lap['seed'] == 100_000)
    assert said_by(typed, 'python drive.py') == (
        f'{first["episode_return"]:.1f} points in {first["frames"]} frames\n')


def test_with_the_shipped_model_the_program_drives_the_lap_of_its_record(tmp_path):
    pytest.importorskip('onnx', reason='onnx is not installed')
    pytest.importorskip('onnxruntime', reason='onnxruntime is not installed')
    (tmp_path / 'drive.py').write_text(next(text for kind, text in BLOCKS if kind == 'python'))
    for words in (['-m', 'carracing_dqn.bringup', 'export', 'racing', '--onnx', 'mine.onnx'],
                  ['drive.py']):
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True,
                              text=True)
        assert done.returncode == 0, done.stderr
    record = ROOT / 'models' / 'racing' / 'record' / 'evaluation.json'
    first = json.loads(record.read_text())['laps'][0]
    assert done.stdout == f'{first["episode_return"]:.1f} points in {first["frames"]} frames\n'


def test_what_is_left_out_or_shortened_is_on_the_page():
    assert all(line in SHELL for line in DONE)
    assert sum(line.count(FEWER_MINUTES[0]) for line in SHELL) == 1
