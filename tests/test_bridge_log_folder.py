# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A node starts where its user has no home, and says so where ROS cannot write its logs."""
import os
from pathlib import Path
import subprocess
import sys

from msgs_bridge.errors import BridgeError
from msgs_bridge.log_folder import ensure_log_folder
import pytest

# no user, root included, can make a folder here
NOWHERE = '/dev/null/home'


@pytest.fixture
def environment(monkeypatch, tmp_path):
    for name in ('ROS_LOG_DIR', 'ROS_HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path / 'temporary'))
    (tmp_path / 'temporary').mkdir(mode=0o700)
    yield monkeypatch
    # monkeypatch would put back what the test has left there
    os.environ.pop('ROS_LOG_DIR', None)


def test_a_home_is_left_to_rcl(environment, tmp_path):
    environment.setenv('HOME', str(tmp_path))
    ensure_log_folder()
    assert 'ROS_LOG_DIR' not in os.environ and (tmp_path / '.ros' / 'log').is_dir()


def test_rcl_is_told_of_a_home_that_only_the_list_of_users_knows(environment, tmp_path):
    environment.delenv('HOME')
    environment.setattr(Path, 'home', lambda: tmp_path)
    ensure_log_folder()
    assert os.environ['ROS_LOG_DIR'] == str(tmp_path / '.ros' / 'log')


def test_without_a_home_logs_go_to_a_temporary_folder_of_the_user_alone(environment, tmp_path):
    environment.setenv('HOME', NOWHERE)
    ensure_log_folder()
    folder = Path(os.environ['ROS_LOG_DIR'])
    assert folder.parent == tmp_path / 'temporary' and folder.stat().st_mode & 0o777 == 0o700
    ensure_log_folder()
    folder.chmod(0o777)
    environment.delenv('ROS_LOG_DIR')
    with pytest.raises(BridgeError, match='set ROS_LOG_DIR to one: .* writable by others'):
        ensure_log_folder()


def test_a_place_that_was_named_must_be_there(environment):
    for name in ('ROS_LOG_DIR', 'ROS_HOME'):
        environment.setenv(name, NOWHERE)
        with pytest.raises(BridgeError, match='ROS has no place for its logs'):
            ensure_log_folder()
        environment.delenv(name)


def test_a_node_ends_in_one_line_where_rcl_would_end_in_a_traceback():
    done = subprocess.run(
        [sys.executable, '-m', 'bags.player_node'], capture_output=True, text=True, timeout=60,
        env={**os.environ, 'ROS_LOG_DIR': NOWHERE})
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith('error: ROS has no place for its logs')
