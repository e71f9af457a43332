# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A node as a process: its arguments, its parameter files, its signals."""
import os
import signal
import subprocess
import sys

from graph_probe import ROOT
import pytest

NODE = '''
"""Purpose: nothing but its parameters."""
import dataclasses, sys
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.settings import setting

@dataclasses.dataclass(frozen=True)
class Settings:
    run: str = setting('', 'name of a run')
    rate: float = setting(1.0, 'how often', low=0.1, high=100.0)
    seed: int = setting(0, 'of what is drawn', low=0, high=10)

class Node(NodeShell):
    """
    A made-up node.

    Purpose: it tells its settings.
    """

    def __init__(self):
        super().__init__('made_up', Settings)
        print('settings', repr(self.settings.run), self.settings.rate, flush=True)
        if self.settings.run != 'stay':
            raise Finished
        # once it runs, so that what is tested is a signal then
        self.create_timer(0.1, lambda: print('running', flush=True))

    def close(self):
        print('closed', flush=True)

run_node(Node)
'''
COMMAND = [sys.executable, '-c', NODE]


def node(*arguments, **options):
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=60,
                          cwd=ROOT, **options)


@pytest.mark.parametrize('arguments, words', [
    (['-p', 'seed:=7'], "unknown argument '-p'; parameters go after --ros-args"),
    (['--nonsense'], "unknown argument '--nonsense'"),
    (['--ros-args', '--nonsense'], 'nonsense'),
    (['--ros-args', '--params-file', '/no/such/file'], '/no/such/file'),
    (['--ros-args', '-p', 'sed:=7'], "unknown setting 'sed'; did you mean 'seed'?"),
    (['--ros-args', '-p', 'seed:=seven'], "seed must be a whole number, not 'seven'"),
    (['--ros-args', '-p', 'seed:=11'], 'seed is 11; accepted: 0 to 10'),
    (['--ros-args', '-p', 'rate:=true'], 'rate must be a number, not True'),
    (['--ros-args', '-p', 'use_sim_time:=3'], 'use_sim_time'),
    (['--ros-args', '-p', 'use_sim_timee:=true'], "unknown setting 'use_sim_timee'"),
    (['--ros-args', '-p', 'start_type_description_service:=3'], 'start_type_description_service'),
])
def test_what_is_wrong_is_told_in_one_line(arguments, words):
    done = node(*arguments)
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1 and words in lines[0] and 'Traceback' not in done.stderr
    assert len(lines[0]) < 400


@pytest.mark.parametrize('domain', ['foo', '233', '-1', '0x1', '9' * 5000])
def test_a_domain_that_there_is_not_is_told_in_one_line(domain):
    done = node(env={**os.environ, 'ROS_DOMAIN_ID': domain})
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert 'ROS_DOMAIN_ID' in done.stderr and 'accepted: 0 to 232' in done.stderr
    assert len(done.stderr) < 200


def test_an_error_is_one_line_whatever_it_quotes():
    made = 'import sys\nfrom msgs_bridge import errors, node_process\n' \
           'def fail(): raise errors.BridgeError(sys.argv[1])\nnode_process.run_node(fail, [])'
    done = subprocess.run(
        [sys.executable, '-c', made, '\x1b]0;OWNED\x07\nerror: ' + 'x' * 5000],
        capture_output=True, text=True, timeout=60, cwd=ROOT)
    assert done.returncode == 2 and done.stderr.startswith('error: ?]0;OWNED??error: xxx')
    assert done.stderr[:-1].isprintable() and len(done.stderr) < 1100


@pytest.mark.parametrize(('shell', 'code', 'told'), [
    ('"$@" --help > /dev/full', 2, 'error: standard output: No space left on device\n'),
    ('set -o pipefail; "$@" --help | true', 141, '')])
def test_help_that_nobody_takes_is_no_traceback(shell, code, told):
    # a pipe is closed at the other end before an interpreter has started
    done = subprocess.run(['bash', '-c', shell, 'bash', *COMMAND], capture_output=True, text=True,
                          timeout=60, cwd=ROOT)
    assert (done.returncode, done.stderr) == (code, told)


def test_help_describes_the_node_without_starting_it():
    done = node('--help')
    assert done.returncode == 0 and not done.stderr
    for words in ('Purpose: it tells its settings.', '  rate (float, 1.0; 0.1 to 100)',
                  '      how often', 'fast_transport'):
        assert words in done.stdout


@pytest.mark.parametrize('text', ['2026', '42', '007', '1e3', '1.50', 'true', '2026-11-25'])
def test_a_number_may_be_a_name(text):
    assert f"settings '{text}' 1.0" in node('--ros-args', '-p', f'run:={text}').stdout


def test_a_section_for_all_nodes_may_hold_what_belongs_to_others(tmp_path):
    path = tmp_path / 'all.yaml'
    path.write_text('/**:\n  ros__parameters:\n    rate: 2\n    wheel_radius: 0.3\n    ratee: 4\n'
                    '    pid: {p: 1.0}\n')
    done = node('--ros-args', '--params-file', str(path))
    assert done.returncode == 0 and "settings '' 2.0" in done.stdout
    said = done.stdout + done.stderr
    assert "unknown setting 'wheel_radius'" in said and "'pid.p'" in said
    assert "did you mean 'rate'?" in said


@pytest.mark.parametrize('section', ['made_up', '/made_up', '/**/made_up'])
def test_a_typo_in_a_section_of_its_own_is_refused(tmp_path, section):
    path = tmp_path / 'own.yaml'
    path.write_text(f'{section}:\n  ros__parameters:\n    ratee: 4\n')
    done = node('--ros-args', '--params-file', str(path))
    if '*' in section:
        # a section for nodes of that name in any namespace is one for several
        assert done.returncode == 0
    else:
        assert done.returncode == 2 and "did you mean 'rate'?" in done.stderr


def test_a_typo_on_the_command_line_is_refused_beside_a_file_for_all(tmp_path):
    path = tmp_path / 'all.yaml'
    path.write_text('/**:\n  ros__parameters:\n    sed: 3\n')
    done = node('--ros-args', '--params-file', str(path), '-p', 'sed:=4')
    assert done.returncode == 2 and "did you mean 'seed'?" in done.stderr


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_it_well(number):
    process = subprocess.Popen([*COMMAND, '--ros-args', '-p', 'run:=stay'],
                               stdout=subprocess.PIPE, text=True, cwd=ROOT)
    while process.stdout.readline() != 'running\n':
        pass
    process.send_signal(number)
    assert process.wait(20) == 0
    assert process.stdout.read().endswith('closed\n')


IMPORTED = """
import importlib.abc, os, runpy, signal, sys

class Interrupting(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)
            raise ImportError('what a compiled module makes of an interrupt')

sys.meta_path.insert(0, Interrupting())
# who runs the tests in the background of a shell ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
{start}
"""


@pytest.mark.parametrize(('start', 'module', 'code'), [
    *((f'runpy.run_module({package!r}, run_name="__main__")', f'{package}.node', 0)
      for package in ('carracing_sim_node', 'dqn_policy_node', 'trainer_node')),
    ('from carracing_dqn.bringup import start; start.trainer_node()', 'trainer_node.node', 0),
    ('from carracing_dqn.bringup import start; start.carracing()',
     'carracing_dqn.bringup.command', 130),
])
def test_what_is_interrupted_while_it_imports_says_nothing(start, module, code):
    done = subprocess.run(
        [sys.executable, '-c', IMPORTED.replace('{start}', start), module], cwd=ROOT,
        capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, '', '')
