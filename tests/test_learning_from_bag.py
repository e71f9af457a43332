# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from bags: the same trainer, with checkpoints, validations and an end of its own."""
import io
import signal
import subprocess
import sys

from bag_cases import record_drive, scripted
from bags.errors import BagError
from carracing_dqn.bringup.train_from_bag import learn_from_bags
from dqn_policy_node.action_space import DUMMY_SPACE
from dqn_policy_node.model_folder import load_model
from graph_probe import carracing
from learning_cases import rows, TINY
from msgs_bridge.errors import SettingsError
import pytest
from rich.console import Console
from trainer_node.errors import LearningError
from trainer_node.run_folder import RunFolder
from trainer_node.training import Training
import yaml

EPISODES, DECISIONS = 4, 30


def discrete(decision):
    return DUMMY_SPACE.commands[decision % 5]


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return record_drive(tmp_path_factory.mktemp('bags') / 'bag', episodes=EPISODES,
                        decisions=DECISIONS, drive_with=discrete)


@pytest.fixture
def preset(tmp_path):
    path = tmp_path / 'tiny.yaml'
    path.write_text(yaml.safe_dump({
        **TINY, 'action_repeat': 1, 'validation_every_episodes': 0, 'run_minutes': 5.0,
        'learning_rate_schedule': 'linear'}))
    return path


def learn(bags, folder, preset, *, resume=False, namespace='', **overrides):
    output = io.StringIO()
    code = learn_from_bags(
        list(bags), folder, str(preset), overrides, Console(file=output, width=200),
        namespace=namespace, resume=resume, tensorboard=False)
    assert code == 0
    return output.getvalue()


def test_a_run_ends_with_its_bags_and_by_their_share_of_it(bag, preset, tmp_path):
    said = learn([bag], tmp_path / 'run', preset)
    run = RunFolder(tmp_path / 'run')
    assert f'saved {run.final}' in said
    assert run.read_record()['complete'] is True
    status = Training.resume(run.path, device='cpu').status()
    assert status['decisions'] == EPISODES * DECISIONS
    # no clock: the rate has fallen to its end, and the same bag gives the same weights
    assert status['learning_rate'] < 1e-5
    learn([bag], tmp_path / 'again', preset)
    first, second = (load_model(tmp_path / name / 'final') for name in ('run', 'again'))
    assert all((tensor == second.tensors[name]).all() for name, tensor in first.tensors.items())


def test_continuous_actions_are_learned_from_whoever_drove(preset, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=2, decisions=40, drive_with=scripted)
    said = learn([bag], tmp_path / 'run', preset, action_space='continuous')
    assert 'saved' in said
    status = Training.resume(tmp_path / 'run', device='cpu').status()
    assert status['decisions'] == 80 and status['foreign_actions'] == 0


def test_validations_are_driven_and_the_best_is_kept(bag, preset, tmp_path):
    learn([bag], tmp_path / 'run', preset, validation_every_minutes=2.5, validation_tracks=1)
    run = RunFolder(tmp_path / 'run')
    found = rows(run.validation)
    # at half of it and at its end
    assert [int(row['decisions']) for row in found] == [62, 120]
    best = load_model(run.best)
    assert best.training['best_validation']['mean'] == pytest.approx(
        max(float(row['mean']) for row in found), rel=1e-4)


def test_a_run_that_is_killed_goes_on_where_its_checkpoint_was(bag, preset, tmp_path):
    learn([bag], tmp_path / 'whole', preset)
    preset.write_text(preset.read_text() + 'checkpoint_every_minutes: 0.001\n')
    run = RunFolder(tmp_path / 'run')
    # SIGKILL after the second checkpoint
    code = (
        'import os, signal\nfrom pathlib import Path\nfrom rich.console import Console\n'
        'from carracing_dqn.bringup.train_from_bag import learn_from_bags\n'
        'from trainer_node.training import Training\n'
        'save, saves = Training.save, []\n'
        'def counted(self):\n'
        '    path = save(self)\n'
        '    saves.append(self.decisions)\n'
        '    if len(saves) > 2 and self.decisions > 40:\n'
        '        os.kill(os.getpid(), signal.SIGKILL)\n'
        '    return path\n'
        'Training.save = counted\n'
        f'learn_from_bags([Path({str(bag)!r})], Path({str(run.path)!r}), {str(preset)!r}, {{}}, '
        'Console(), namespace="", resume=False, tensorboard=False)\n')
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                            timeout=120)
    assert result.returncode == -signal.SIGKILL, result.stderr
    before = Training.resume(run.path, device='cpu').decisions
    assert 40 < before < EPISODES * DECISIONS
    learn([bag], run.path, preset, resume=True)
    assert rows(run.episodes)[-1]['decisions'] == str(EPISODES * DECISIONS)
    whole, parts = (load_model(tmp_path / name / 'final') for name in ('whole', 'run'))
    assert all((tensor == parts.tensors[name]).all() for name, tensor in whole.tensors.items())


def test_a_run_goes_on_with_another_bag_from_its_start(bag, preset, tmp_path):
    other = record_drive(tmp_path / 'other', episodes=1, decisions=20, drive_with=discrete)
    learn([bag], tmp_path / 'run', preset, run_decisions=1000)
    learn([other], tmp_path / 'run', preset, resume=True)
    assert Training.resume(tmp_path / 'run', device='cpu').decisions == (
        EPISODES * DECISIONS + 20)


def test_a_run_grows_by_other_bags_whatever_they_are_called(bag, preset, tmp_path):
    """Every bag of `carracing run` is called bag."""
    other = record_drive(tmp_path / 'other' / bag.name, episodes=2, decisions=40,
                         drive_with=discrete)
    learn([bag], tmp_path / 'run', preset)
    assert 'validation' not in learn([bag], tmp_path / 'run', preset, resume=True)
    assert Training.resume(tmp_path / 'run', device='cpu').decisions == EPISODES * DECISIONS
    learn([other], tmp_path / 'run', preset, resume=True)
    run = Training.resume(tmp_path / 'run', device='cpu')
    assert run.decisions == EPISODES * DECISIONS + 80
    # a limit that was asked for stays
    learn([bag], tmp_path / 'short', preset, run_decisions=100)
    learn([other], tmp_path / 'short', preset, resume=True)
    assert Training.resume(tmp_path / 'short', device='cpu').decisions == 100


def test_a_run_of_bags_has_no_clock_though_its_preset_has_both_limits(bag, preset, tmp_path):
    learn([bag], tmp_path / 'run', preset, run_decisions=100)
    settings = Training.resume(tmp_path / 'run', device='cpu').settings
    assert (settings.run_minutes, settings.run_decisions) == (0, 100)


def test_frames_of_a_bag_make_decisions_of_the_length_that_is_learned(bag, preset, tmp_path):
    learn([bag], tmp_path / 'run', preset, action_repeat=3, action_space='continuous')
    status = Training.resume(tmp_path / 'run', device='cpu').status()
    assert status['decisions'] == EPISODES * DECISIONS // 3
    assert status['learning_rate'] < 2e-5
    with pytest.raises(LearningError, match='0.02 s apart, of which no number makes .* 0.03 s'):
        learn([bag], tmp_path / 'other', preset, frame_seconds=0.03)
    assert not (tmp_path / 'other').exists()


def test_fewer_transitions_than_learning_needs_are_named(bag, preset, tmp_path):
    with pytest.raises(SettingsError, match='at most 123 transitions.*learning_starts 2000'):
        learn([bag], tmp_path / 'run', preset, learning_starts=2000, replay_capacity=3000)
    assert not (tmp_path / 'run').exists()
    learn([bag], tmp_path / 'run', preset, learning_starts=100)
    assert Training.resume(tmp_path / 'run', device='cpu').status()['updates'] == 20


def test_several_cars_need_a_namespace(preset, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=40, drive_with=discrete,
                       namespace='/car1')
    learn([bag], tmp_path / 'run', preset, namespace='/car1')
    with pytest.raises(BagError, match='has no image_raw'):
        learn([bag], tmp_path / 'other', preset, namespace='/car2')
    assert not (tmp_path / 'other').exists()


def test_steps_without_what_shaping_needs_are_one_line(preset, tmp_path):
    def bare(frame):
        for name in ('came_round', 'lap_position'):
            frame.step.info.pop(name, None)
        return frame

    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=40, drive_with=discrete,
                       change=bare)
    learn([bag], tmp_path / 'plain', preset)
    with pytest.raises(LearningError, match="finish_bonus is 25.0 and needs 'came_round'"):
        learn([bag], tmp_path / 'run', preset, finish_bonus=25.0)


@pytest.mark.parametrize('words, error', [
    (('--from-bag', 'nowhere'), 'nowhere'),
    (('--from-bag', 'BAG', '--namespace', '/car7'), 'has no image_raw'),
    (('--from-bag', 'BAG', '--set', 'gama=0.9'), "did you mean 'gamma'"),
])
def test_a_typo_is_one_line_and_leaves_no_folder(bag, words, error, tmp_path):
    run = tmp_path / 'run'
    result = carracing('train', '--run', str(run), *(
        str(bag) if word == 'BAG' else word for word in words))
    assert result.returncode == 2
    assert result.stderr.startswith('error: ') and error in result.stderr
    assert result.stderr.count('\n') == 1
    assert not run.exists()


def test_a_disk_without_room_is_one_line_and_the_checkpoint_before_is_kept(bag, preset, tmp_path):
    learn([bag], tmp_path / 'run', preset, run_decisions=1000)
    run = RunFolder(tmp_path / 'run')
    kept = run.checkpoint.read_bytes()
    other = record_drive(tmp_path / 'other', episodes=2, decisions=30, drive_with=discrete)
    # no file may become longer than 1 KiB, which says what a full disk says: not a byte more
    result = subprocess.run(
        ['bash', '-c', 'ulimit -f 1; exec "$@"', 'bash', sys.executable, '-m',
         'carracing_dqn.bringup', 'train', '--resume', str(run.path), '--from-bag', str(other)],
        capture_output=True, text=True, timeout=120)
    assert result.returncode == 2, result.stderr
    assert 'Traceback' not in result.stderr
    assert result.stderr.splitlines()[-1].startswith(f'error: {run.path}')
    assert 'cannot be written: File too large' in result.stderr
    assert run.checkpoint.read_bytes() == kept
