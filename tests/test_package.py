# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The package as ROS tools see it; what needs those tools is skipped where they are missing."""
import os
from pathlib import Path
import shutil
import subprocess
import sys
from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_directory
from carracing_dqn.bringup.environment import executables, lay_out
import pytest

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent


def test_package_xml_is_format_3_for_ament_python_and_names_what_the_code_imports():
    root = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert root.get('format') == '3'
    assert root.findtext('export/build_type') == 'ament_python'
    named = {element.text for element in root.iter() if element.tag.endswith('depend')}
    imported = set()
    for path in ROOT.glob('*/*.py'):
        for line in path.read_text().splitlines():
            words = line.split()
            if words[:1] == ['from'] and words[1].split('.')[-1] in ('msg', 'srv'):
                imported.add(words[1].split('.')[0])
    assert {'sensor_msgs', 'std_srvs'} <= imported
    assert imported <= named


def test_the_layout_lets_ament_find_the_package(tmp_path, monkeypatch):
    lay_out(tmp_path, ROOT)
    lay_out(tmp_path, ROOT)  # a second time changes nothing
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    share = Path(get_package_share_directory('carracing_dqn'))
    assert (share / 'package.xml').is_file() and (share / 'config' / 'report.yaml').is_file()
    assert sorted(path.name for path in (share / 'launch').iterdir()) == [
        'car.launch.py', 'learner.launch.py', 'race.launch.py', 'replay.launch.py',
        'train.launch.py']
    assert not (share / 'launch').is_symlink()


@pytest.mark.parametrize('name', ['carracing', 'bag_player_node', 'carracing_sim_node'])
def test_without_ros_an_executable_says_so_in_one_line(name):
    hidden = (
        'import sys; sys.modules["rclpy"] = None; from carracing_dqn.bringup import start; '
        f'sys.argv[1:] = ["run"] * ({name!r} == "carracing"); sys.exit(start.{name}())')
    done = subprocess.run([sys.executable, '-c', hidden], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("error: the Python package 'rclpy'") and 'wheels' in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_too_few_open_files_are_raised_or_told_in_one_line():
    def run(limits):
        return subprocess.run(
            ['bash', '-c', f'ulimit {limits}; exec "$@"', 'bash', sys.executable, '-m',
             'carracing_dqn.bringup', 'bag', '--help'], capture_output=True, text=True)

    assert run('-S -n 20').returncode == 0
    done = run('-n 20')
    assert done.returncode == 2 and 'ulimit -n 1024' in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_too_little_memory_is_told_in_one_line_before_a_library_ends_it():
    done = subprocess.run(
        ['bash', '-c', 'ulimit -v 300000; exec "$@"', 'bash', sys.executable, '-m',
         'carracing_dqn.bringup', 'train'], capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith('error: only 292 MiB of memory')


@pytest.mark.parametrize('closed', ['<&-', '>&-', '2>&-', '<&- >&- 2>&-'])
@pytest.mark.parametrize(('name', 'word'), [
    ('carracing', '--version'), ('referee_node', '--help')])
def test_a_stream_that_is_closed_leads_nowhere(name, word, closed):
    done = subprocess.run(
        ['bash', '-c', f'exec "$@" {closed}', 'bash', sys.executable, '-c',
         f'import sys; from carracing_dqn.bringup import start; sys.argv[1:] = [{word!r}]; '
         f'sys.exit(start.{name}())'], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, '')
    assert bool(done.stdout) == (' >&-' not in f' {closed}')


def test_a_node_that_is_stopped_while_it_starts_says_nothing():
    slow = ('import os, signal, sys, types; from carracing_dqn.bringup import start; '
            'sys.meta_path.insert(0, types.SimpleNamespace(find_spec=lambda name, *_: '
            'name == "torch" and os.kill(os.getpid(), signal.SIGINT) or None)); '
            'sys.exit(start.dqn_policy_node())')
    done = subprocess.run([sys.executable, '-c', slow], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.skipif(not shutil.which('colcon', path=BIN), reason='colcon is not installed')
@pytest.mark.parametrize('options', [(), ('--symlink-install',)], ids=['copied', 'linked'])
def test_colcon_builds_it_as_an_ament_python_package(tmp_path, options):
    (tmp_path / 'src').mkdir()
    shutil.copytree(ROOT, tmp_path / 'src' / 'carracing_dqn', ignore=shutil.ignore_patterns(
        '.*', 'runs', 'build', 'install', 'log', '*.egg-info', 'tests', 'docs'))
    environment = {**os.environ, 'AMENT_PREFIX_PATH': sys.prefix}
    environment.pop('PYTHONDONTWRITEBYTECODE', None)  # setuptools warns of it
    done = subprocess.run([f'{BIN}/colcon', 'build', *options], cwd=tmp_path, env=environment,
                          capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, '')
    built = tmp_path / 'install' / 'carracing_dqn'
    assert {path.name for path in (built / 'lib' / 'carracing_dqn').iterdir()} == set(
        executables())
    assert (built / 'share' / 'carracing_dqn' / 'launch' / 'race.launch.py').is_file()


def test_the_version_stands_in_one_place():
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    said = subprocess.run([sys.executable, '-m', 'carracing_dqn.bringup', '--version'],
                          capture_output=True, text=True, cwd=ROOT)
    assert said.returncode == 0 and said.stdout.startswith(f'carracing {version}')
    assert f"'{version}'" not in (ROOT / 'setup.py').read_text()
    assert (ROOT / 'CHANGELOG.md').read_text().count(f'## {version}') == 1
