# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The launch files, executed; `launch` and `launch_ros` come with ROS 2 and are no wheels."""
import os
from pathlib import Path
import subprocess
import sys

from bag_cases import small_bag
import pytest
import yaml

pytest.importorskip('launch_ros.actions', reason='launch and launch_ros are not installed',
                    exc_type=ImportError)

ROOT = Path(__file__).resolve().parents[1]
# what `ros2 launch` does with the words after the name of the file
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]),
    launch_arguments=[word.split(':=') for word in sys.argv[2:]])]))
sys.exit(service.run())
"""


def launch(name, folder, *arguments):
    """Execute a launch file in a folder until it ends; return its code and its words."""
    done = subprocess.run(
        [sys.executable, '-c', LAUNCH, str(ROOT / 'launch' / f'{name}.launch.py'), *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=120,
        env={**os.environ, 'AMENT_PREFIX_PATH': sys.prefix, 'ROS_LOG_DIR': str(folder / 'log')})
    return done.returncode, done.stdout


@pytest.mark.parametrize('word', ['2026-11-25', '2026', 'true', '0x10'])
def test_a_bag_by_a_name_that_looks_like_something_else_is_a_text(tmp_path, word):
    code, words = launch('replay', tmp_path, f'bag:={word}')
    assert code == 1
    assert f'error: {word}' in words.replace("'", ''), words


def test_a_launch_ends_with_the_node_that_failed(tmp_path):
    code, words = launch('race', tmp_path, 'model:=42')
    assert code == 1
    assert "'42'" in words and 'dqn_policy_node' in words and 'ended with code 2' in words


def test_a_launch_ends_well_with_the_node_that_is_done(tmp_path):
    small_bag(tmp_path / '2026-11-25')
    code, words = launch('replay', tmp_path, 'bag:=2026-11-25', 'rate:=1000.0')
    assert code == 0, words


def test_training_ends_where_the_trainer_cannot_begin(tmp_path):
    (tmp_path / 'taken').write_text('a file, no folder')
    code, words = launch('train', tmp_path, 'run:=taken', 'preset:=report')
    assert code == 1 and 'trainer_node' in words, words


def test_another_simulator_is_learned_in_by_its_name(tmp_path):
    code, words = launch(
        'train', tmp_path, 'simulator:=pendulum', 'run:=learned',
        'overrides:=run_decisions=300,learning_starts=64,validation_tracks=1')
    assert code == 0, words
    settings = yaml.safe_load((tmp_path / 'learned' / 'config.yaml').read_text())
    # of the profile, of the simulator, and of the words
    assert (settings['action_space'], settings['frame_width'], settings['run_decisions']) == (
        'steer5', 48, 300)
    assert (tmp_path / 'learned' / 'final' / 'model.json').is_file()


def test_another_simulator_is_driven_by_its_name(tmp_path):
    code, words = launch('race', tmp_path, 'simulator:=nowhere')
    assert code == 1 and 'nowhere' in words, words
