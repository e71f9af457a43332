# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The whole learning graph: it learns, it survives, it goes on, and a bag tells the same story."""
import csv
import os
from pathlib import Path
import signal
import subprocess
import sys

from bags.cdr_time import first_time
from bags.frames import recorded_frames
from bags.reader import BagReader
from bags.transitions import bag_transitions
from dqn_policy_node.action_space import action_space
from graph_probe import carracing, start_carracing, wait_for
import numpy as np
import pytest
from trainer_node.checkpoint_file import read_checkpoint
from trainer_node.run_folder import RunFolder
import yaml

TINY = {
    'convolutions': '8@8/4 8@4/2', 'hidden': 16, 'shrink': 2, 'action_repeat': 4,
    'early_end_frames': 60, 'learning_starts': 20, 'replay_capacity': 5000, 'weights_every': 20,
    'validation_tracks': 1, 'validation_every_episodes': 0, 'run_episodes': 0,
    'checkpoint_every_minutes': 0.03,
}


@pytest.fixture
def preset(tmp_path):
    path = tmp_path / 'tiny.yaml'
    path.write_text(yaml.safe_dump(TINY))
    return str(path)


pytestmark = pytest.mark.usefixtures('own_domain')


def rows(path):
    with open(path, newline='') as file:
        return list(csv.DictReader(file))


def learning(run):
    return read_checkpoint(RunFolder(run).checkpoint)[1]['learning']


def decisions(run):
    try:
        return int(rows(run / 'episodes.csv')[-1]['decisions'])
    except (OSError, IndexError):
        return 0


def node_of(process, module):
    """Return the process of a node of a command."""
    found = subprocess.run(['pgrep', '-P', str(process.pid), '-f', '--', f'-m {module} '],
                           capture_output=True, text=True)
    return int(found.stdout)


def stop(process, number=signal.SIGINT):
    """Stop a command as a user would; return what it said."""
    process.send_signal(number)
    said, _ = process.communicate(timeout=180)
    return said


def test_train_stop_and_resume(preset, tmp_path):
    run = tmp_path / 'run'
    process = start_carracing('train', '--preset', preset, '--run', str(run))
    try:
        wait_for(lambda: decisions(run) > 100 or process.poll() is not None, 60, '100 decisions')
        said = stop(process)
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert 'killed' not in said
    first = rows(run / 'episodes.csv')
    state = learning(run)
    assert state['episodes'] == len(first)
    assert state['updates'] > 0
    process = start_carracing('train', '--resume', str(run))
    try:
        wait_for(lambda: decisions(run) > state['decisions'] + 100
                 or process.poll() is not None, 60, '100 more decisions')
        said = stop(process, signal.SIGTERM)
    finally:
        process.kill()
    second = rows(run / 'episodes.csv')
    assert second[:len(first)] == first, said
    numbers = [int(row['episode']) for row in second]
    assert numbers == list(range(len(second)))
    epsilons = [float(row['epsilon']) for row in second]
    assert np.allclose(epsilons, 0.995 ** np.arange(len(second)))
    counts = [int(row['decisions']) for row in second]
    assert counts == sorted(counts)


def test_a_node_that_dies_ends_the_run_with_its_name_and_the_run_can_go_on(preset, tmp_path):
    run = tmp_path / 'run'
    process = start_carracing('train', '--preset', preset, '--run', str(run))
    try:
        checkpoint = RunFolder(run).checkpoint
        wait_for(lambda: checkpoint.exists() and decisions(run) > 50, 60, 'a checkpoint')
        os.kill(node_of(process, 'trainer_node'), signal.SIGKILL)
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 2
    assert 'error: trainer ended with signal SIGKILL' in said
    assert said.splitlines()[-1].endswith(f'go on with: carracing train --resume {run}')
    before = learning(run)['decisions']
    result = carracing('train', '--resume', str(run), '--set',
                       f'run_decisions={before + 60}', timeout=90)
    assert result.returncode == 0, result.stdout + result.stderr
    assert learning(run)['decisions'] == before + 60
    assert (run / 'final' / 'model.json').is_file()
    assert (run / 'validation.csv').read_text().count('\n') == 2


@pytest.mark.parametrize('space', ['seed5', 'continuous'])
def test_a_recorded_run_holds_every_transition_that_was_learned_from(space, preset, tmp_path):
    run = tmp_path / 'run'
    result = carracing('train', '--preset', preset, '--run', str(run), '--bag', '--set',
                       'run_decisions=300', '--set', f'action_space={space}', timeout=90)
    assert result.returncode == 0, result.stdout + result.stderr
    learned = learning(run)['decisions']
    joined = list(bag_transitions([run / 'bag']))
    assert learned == 300 and len(joined) >= 300
    returns = [float(row['train_reward']) for row in rows(run / 'episodes.csv')]
    ends = [t.step.episode_return for t in joined if t.step.ended]
    # what `q_values` says of an action is what was driven
    own = action_space(space)
    with BagReader(run / 'bag') as reader:
        said = {frame.stamp: frame.q_values for frame in recorded_frames(reader)}
    for transition in joined:
        bundle = said[transition.stamp]
        assert list(bundle)[:len(own)] == list(own.names)
        place = own.encode(transition.command)
        assert all(bundle[name] == value for name, value in own.chosen(place).items())
    # the CSV has six digits
    assert ends[:len(returns)] == pytest.approx(returns, rel=1e-5)
    again = tmp_path / 'again'
    result = carracing('train', '--preset', preset, '--run', str(again), '--from-bag',
                       str(run / 'bag'), '--set', 'run_decisions=300', '--set',
                       f'action_space={space}', timeout=90)
    assert result.returncode == 0, result.stdout + result.stderr
    same = [(row['train_reward'], row['decisions'], row['updates'], row['loss'])
            for row in rows(again / 'episodes.csv')]
    assert same == [(row['train_reward'], row['decisions'], row['updates'], row['loss'])
                    for row in rows(run / 'episodes.csv')]


def test_run_drives_laps_and_leaves_a_bag(tmp_path):
    output = tmp_path / 'drive'
    result = carracing('run', '--model', 'random', '--laps', '2', '--output', str(output))
    assert result.returncode == 0, result.stdout + result.stderr
    assert '2 laps' in result.stdout
    joined = list(bag_transitions([output / 'bag']))
    ends = [t for t in joined if t.terminated or t.truncated]
    assert [t.step.seed for t in ends] == [420, 421]
    assert len(joined) == sum(t.step.decision for t in ends)
    with BagReader(output / 'bag') as reader:
        first = {name: next(reader.messages([name])) for name in ('/cmd_vel', '/q_values')}
        # the first decision is there, too
        assert len({first_time(bytes(message.data)) for message in first.values()}) == 1
        # and who gets the bag does not learn whose home it comes from
        logged = [bytes(message.data) for message in reader.messages(['/rosout'])]
        assert any(b'dqn_policy_node/node.py' in one for one in logged)
        folders = [str(folder).encode() for folder in (Path(__file__).parents[1], tmp_path)]
        assert not any(folder in bytes(message.data) for folder in folders
                       for message in reader.messages(list(reader.topics)))


def test_a_drive_without_end_that_is_stopped_at_a_terminal_draws_its_laps(terminal, tmp_path):
    drive = terminal([
        sys.executable, '-m', 'carracing_dqn.bringup', 'run', '--model', 'random', '--laps', '0',
        '--output', str(tmp_path / 'drive')])
    # until it drives it says what it waits for
    drive.until(r'starting|waiting for', 60)
    drive.until(r' 420 ', 120)
    drive.type(b'\x03')
    drive.until('drawing the laps; Ctrl-C ends that, too', 60)
    drive.until('picture: ', 60)
    assert drive.process.wait(60) == 130
    assert (tmp_path / 'drive' / 'pictures' / 'lap-420.png').is_file()


@pytest.mark.parametrize('words, error', [
    (('train', '--preset', 'racign'), "no preset 'racign'"),
    (('train', '--set', 'gama=0.9'), "did you mean 'gamma'"),
    (('train', '--set', 'gamma=1.5'), 'gamma is 1.5; accepted: 0 to 1'),
    (('train', '--set', 'gamma'), 'expected NAME=VALUE'),
    (('train', '--resume', 'nowhere'), 'nowhere is no run folder'),
    (('run', '--model', 'nothing'), "no model 'nothing': neither"),
    (('run', '--model', 'nothing'), 'of the shipped, which are mujoco_car, '),
    (('run', '--laps', '-1'), '--laps is -1'),
])
def test_mistakes_on_the_command_line_are_one_line_and_leave_nothing(words, error, tmp_path):
    before = set((tmp_path).iterdir())
    environment = {**os.environ, 'PYTHONPATH': str(os.getcwd())}
    result = carracing(*words, env=environment)
    assert result.returncode == 2
    assert result.stderr.startswith('error: ') and error in result.stderr
    assert result.stderr.count('\n') == 1
    assert set(tmp_path.iterdir()) == before


def test_an_output_folder_that_exists_is_not_touched(tmp_path):
    (tmp_path / 'kept').write_text('as it was')
    result = carracing('run', '--model', 'random', '--output', str(tmp_path))
    assert result.returncode == 2 and 'exists already' in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ['kept']
