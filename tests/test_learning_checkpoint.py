# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: damage of every kind is one line, and a kill at any moment leaves a run whole."""
import copy
import dataclasses
import errno
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys

from dqn_policy_node.model_folder import load_model, save_model
from learning_cases import create, drive, stream, tiny, validation
from msgs_bridge import atomic_write
from msgs_bridge.errors import BridgeError
import pytest
import torch
from trainer_node import observation_blocks, open_run
from trainer_node.checkpoint import Checkpoint
from trainer_node.checkpoint_file import read_checkpoint, write_checkpoint
from trainer_node.errors import RunError
from trainer_node.open_run import open_training, resume_point, run_settings
from trainer_node.run_folder import RunFolder
from trainer_node.training import Training
from trainer_node.without_replay import copy_without_replay, main as without_replay_main


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    """Return the folder of a run with blocks, a model and a pending validation."""
    patch = pytest.MonkeyPatch()
    patch.setattr(observation_blocks, 'BLOCK', 16)
    training = create(tmp_path_factory.mktemp('saved') / 'run')
    drive(training, stream(60))
    training.next_weights(validate=True)
    training.save()
    yield training.folder.path
    patch.undo()


@pytest.fixture
def run(saved, tmp_path):
    """Return a copy of it."""
    return RunFolder(shutil.copytree(saved, tmp_path / 'run'))


def resume(run):
    return Training.resume(run.path, device='cpu')


def is_one_line(error):
    return '\n' not in str(error) and len(str(error)) < 500


def test_a_full_disk_keeps_the_checkpoint_before(tmp_path, monkeypatch):
    training = create(tmp_path / 'run')
    drive(training, stream(30))
    training.save()
    before = training.folder.checkpoint.read_bytes()
    drive(training, stream(30, seed=1))

    def full(handle):
        raise OSError(errno.ENOSPC, 'No space left on device')
    monkeypatch.setattr(atomic_write.os, 'fsync', full)
    with pytest.raises(RunError, match='cannot be written: No space left'):
        training.save()
    monkeypatch.undo()
    assert training.folder.checkpoint.read_bytes() == before
    assert [path.name for path in training.folder.checkpoint.parent.iterdir()] == [
        'checkpoint.safetensors']
    assert Training.resume(tmp_path / 'run', device='cpu').decisions == 30


@pytest.mark.parametrize('how', ['cut', 'empty', 'other', 'missing'])
def test_a_damaged_block_of_observations_is_named(run, how):
    block = sorted(run.checkpoint.parent.glob('observations-*'))[1]
    block.unlink() if how == 'missing' else damage(block, how)
    with pytest.raises(RunError, match=f'{block.name}: (damaged checkpoint|no such file)'):
        resume(run)


def test_blocks_that_no_checkpoint_needs_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(observation_blocks, 'BLOCK', 16)
    training = create(tmp_path / 'run')
    for seed in range(6):
        drive(training, stream(60, seed=seed))
        training.save()
    blocks = list(training.folder.checkpoint.parent.glob('observations-*'))
    assert training.learning.replay.oldest > 100
    assert len(blocks) <= training.settings.replay_capacity // 16 + 1


def damage(path, how):
    data = path.read_bytes()
    path.write_bytes({'cut': data[:len(data) // 2], 'empty': b'', 'other': b'\0' * 500}[how])


@pytest.mark.parametrize('how', ['cut', 'empty', 'other'])
def test_a_damaged_checkpoint_is_named_in_one_line(run, how):
    damage(run.checkpoint, how)
    with pytest.raises(RunError, match='checkpoint.safetensors: damaged') as caught:
        resume(run)
    assert is_one_line(caught.value)


def test_csv_files_that_were_cut_by_hand_are_noticed(run):
    run.episodes.write_text('')
    with pytest.raises(RunError, match='episodes.csv: .* bytes, but'):
        resume(run)


def test_no_flipped_bit_of_a_checkpoint_is_accepted(run):
    good = run.checkpoint.read_bytes()
    header = 8 + int.from_bytes(good[:8], 'little')
    # some hundred places: all kinds of the header's, and of the arrays
    for place in [*range(0, header, header // 150), *range(header, len(good), len(good) // 150)]:
        for bit in (1, 64, 128):
            data = bytearray(good)
            data[place] ^= bit
            run.checkpoint.write_bytes(bytes(data))
            with pytest.raises(RunError) as caught:
                Checkpoint(run.checkpoint).read()
            assert is_one_line(caught.value), place
    run.checkpoint.write_bytes(good)
    assert resume(run).decisions == 60


def test_no_flipped_bit_of_a_block_is_accepted(run):
    block = sorted(run.checkpoint.parent.glob('observations-*'))[0]
    good = block.read_bytes()
    for place in (3, 40, len(good) // 2, len(good) - 1):
        data = bytearray(good)
        data[place] ^= 2
        block.write_bytes(bytes(data))
        with pytest.raises(RunError, match=f'{block.name}: damaged'):
            resume(run)


def test_blocks_that_changed_places_are_noticed(run):
    first, second, *_ = sorted(run.checkpoint.parent.glob('observations-*'))
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)
    with pytest.raises(RunError, match='not the bytes that were written'):
        resume(run)


def leaves(state, path=()):
    if isinstance(state, dict):
        for name, value in state.items():
            yield from leaves(value, (*path, name))
    elif isinstance(state, list):
        yield path, state
        for place, value in enumerate(state):
            yield from leaves(value, (*path, place))
    else:
        yield path, state


def put(state, path, value):
    state = copy.deepcopy(state)
    place = state
    for name in path[:-1]:
        place = place[name]
    place[path[-1]] = value
    return state


# a seed of NumPy's generators may be any whole number of its size
FREE = ('random', 'learner_random')
NULLABLE = ('segment_end', 'published_epsilon', 'best_reward', 'new_validation')
WRONG = {
    int: (-1, 10**30, 1.5, float('nan'), 'x', True, None, [], {}),
    float: (float('nan'), float('inf'), 'x', True, [], {}),
    bool: (2, 'x', None, {}), str: (1, None, []), list: (1, 'x', {}), type(None): ('x', [], {}),
}


def test_a_state_of_another_kind_is_refused_whatever_it_says(run):
    """The checksum is right in all of these: somebody has written them."""
    arrays, state = read_checkpoint(run.checkpoint)
    write_checkpoint(run.checkpoint, arrays, state)
    assert resume(run).decisions == 60
    parts = {name: part for name, part in state.items() if name not in ('settings', 'blocks')}
    tried = 0
    for path, value in leaves(parts):
        if set(path) & set(FREE):
            continue
        # a row of a validation holds figures, no counts
        kind = float if {'best', 'last'} & set(path) else type(value)
        wrong = [other for other in WRONG[kind]
                 if other is not None or path[-1] not in NULLABLE]
        for other in (wrong[tried % len(wrong)], wrong[(tried + 1) % len(wrong)]):
            tried += 1
            write_checkpoint(run.checkpoint, arrays, put(state, path, other))
            with pytest.raises(RunError) as caught:
                resume(run)
                pytest.fail(f'accepted {path} as {other}')
            assert is_one_line(caught.value), (path, other)
    assert tried > 80


@pytest.mark.parametrize('path, value', [
    (('settings',), []), (('settings',), None), (('settings', 'gamma'), 'x'),
    (('settings', 'gamma'), 7.0), (('settings', 'nonsense'), 1),
    (('blocks',), []), (('blocks', '0'), 5), (('blocks', 'x'), 'y'),
    (('learning',), None), (('record',), 'x'), (('clock',), {}),
    (('record', 'positions'), {}), (('record', 'positions', 'episodes'), 3),
    (('record', 'positions', 'episodes'), 10**9),
    (('learning', 'written'), 10**12), (('learning', 'written'), 7),
    (('learning', 'random'), {}), (('learning', 'random'), {'bit_generator': 'PCG64'}),
    (('learning', 'random', 'state', 'state'), -1),
    (('learning', 'learner_random', 'state'), 'x'),
    (('selection', 'pending'), {}), (('selection', 'pending', 'x'), None),
    (('selection', 'best'), {'score': 1.0}), (('selection', 'last'), {'mean': 1.0}),
])
def test_a_state_that_does_not_fit_is_refused(run, path, value):
    arrays, state = read_checkpoint(run.checkpoint)
    write_checkpoint(run.checkpoint, arrays, put(state, path, value))
    with pytest.raises(RunError) as caught:
        resume(run)
    assert is_one_line(caught.value)
    assert run.path.name in str(caught.value)


def test_arrays_that_do_not_fit_are_refused(run):
    arrays, state = read_checkpoint(run.checkpoint)
    write_checkpoint(run.checkpoint, arrays, state)
    assert resume(run).decisions == 60
    for name, array in arrays.items():
        for other in ({}, {name: array[:-1] if array.ndim else array[None]},
                      {name: array.astype('float16')}):
            changed = {**{key: each for key, each in arrays.items() if key != name}, **other}
            write_checkpoint(run.checkpoint, changed, state)
            with pytest.raises(RunError) as caught:
                resume(run)
                pytest.fail(f'accepted {name} as {other.get(name)}')
            assert is_one_line(caught.value), (name, other)


def test_a_checkpoint_of_another_version_is_named(run):
    data = run.checkpoint.read_bytes()
    run.checkpoint.write_bytes(data.replace(b'checkpoint 2', b'checkpoint 1', 1))
    with pytest.raises(RunError, match='not a carracing_dqn checkpoint 2'):
        resume(run)


@pytest.mark.parametrize('name', ['checkpoint/checkpoint.safetensors', 'run.json', 'updates.csv',
                                  'checkpoint/observations-000000000.safetensors'])
def test_what_never_ends_is_not_read(run, name):
    path = run.path / name
    path.unlink()
    os.mkfifo(path)
    if name == 'run.json':
        assert resume(run).decisions == 60
        return
    with pytest.raises(RunError, match='not a regular file'):
        resume(run)


def test_stamps_of_wall_time_are_gone_on_from(tmp_path):
    wall = 1_750_000_000_000_000_000
    training = create(tmp_path / 'run')
    transitions = [dataclasses.replace(
        one, stamp=one.stamp + wall, next_stamp=one.next_stamp + wall) for one in stream(21)]
    drive(training, transitions[:20])
    training.save()
    later = Training.resume(tmp_path / 'run', device='cpu')
    assert later.learning.insert(transitions[20])


@pytest.mark.parametrize('changes', [{'seed': 7}, {'initial_model': 'racing'}])
def test_what_a_run_began_with_cannot_be_changed(run, changes):
    with pytest.raises(RunError, match=f'{next(iter(changes))} is'):
        Training.resume(run.path, tiny(**changes), device='cpu')


def test_a_resume_that_is_refused_leaves_the_rows_that_there_are(run):
    with run.episodes.open('a') as file:
        file.write(run.episodes.read_text().splitlines()[-1] + '\n')
    before = run.episodes.read_bytes()
    next(run.checkpoint.parent.glob('observations-*')).unlink()
    with pytest.raises(RunError):
        resume(run)
    assert run.episodes.read_bytes() == before


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path):
    with pytest.raises(BridgeError, match='no model'):
        create(tmp_path / 'run', initial_model='no such model')
    assert not (tmp_path / 'run').exists()


def test_a_record_that_is_nested_too_deep_is_none(run):
    run.record.write_text('[' * 200_000)
    assert resume(run).decisions == 60


def test_what_was_out_for_validation_is_asked_for_again(run):
    later = resume(run)
    assert later.weights_due()
    version = later.version
    later.next_weights()
    # the result of before may still come, from a validator that lived on
    assert later.record_validation(validation(version, mean=1e3))
    assert later.record_validation(validation(later.version, mean=2e3))


def test_what_killed_saves_left_behind_is_removed(run):
    left = [run.path / '.plan.yaml.abcd1234', run.path / '.evaluation.json.abcd1234',
            run.path / '.demonstrations.safetensors.abcd1234',
            run.checkpoint.parent / '.checkpoint.safetensors.abcd1234',
            run.checkpoint.parent / '.observations-000000003.safetensors.abcd1234',
            run.path / '.run.json.a_b_c_d_', run.path / '.best.12345678' / 'new' / 'model.json']
    left[-1].parent.mkdir(parents=True)
    mine = [run.path / '.notes.txt', run.path / '.best.mine', run.path / '.hidden.abcd1234']
    for path in (*left, *mine):
        path.write_text('x')
    resume(run)
    assert not any(path.exists() for path in left)
    assert all(path.exists() for path in mine)


def test_a_folder_that_was_moved_away_by_a_killed_save_is_put_back(run):
    away = run.path / '.best.abcd1234'
    away.mkdir()
    run.best.rename(away / 'old')
    resume(run)
    assert load_model(run.best).training['episodes'] > 0
    assert not away.exists()


def test_a_file_system_that_cannot_exchange_folders_still_replaces_them(run, monkeypatch):
    monkeypatch.setattr(atomic_write, '_exchange', lambda first, second: False)
    model = load_model(run.best)
    save_model(run.best, model)
    assert load_model(run.best).version == model.version
    assert not list(run.path.glob('.best.*'))


def test_the_best_model_is_whole_whenever_the_process_is_killed(run):
    code = ('import sys\nfrom dqn_policy_node.model_folder import load_model, save_model\n'
            'model = load_model(sys.argv[1])\nprint("go", flush=True)\n'
            'while True: save_model(sys.argv[1], model)')
    for trial in range(3):
        process = subprocess.Popen(
            [sys.executable, '-c', code, str(run.best)], stdout=subprocess.PIPE)
        process.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.02 + 0.03 * trial)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert load_model(run.best).version > 0
    assert resume(run).decisions == 60
    assert not list(run.path.glob('.best.*'))


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_again(tmp_path):
    begun = create(tmp_path / 'run', validation_every_episodes=0)
    drive(begun, stream(60))
    begun.folder.checkpoint.unlink()
    assert len(begun.folder.episodes.read_text().splitlines()) > 1
    settings = run_settings(tmp_path / 'run', 'racing', {}, resume=True)
    assert resume_point(tmp_path / 'run', settings) == (0, 0, {})
    again = open_training(tmp_path / 'run', settings, resume=True, device='cpu')
    assert (again.decisions, again.settings) == (0, begun.settings)
    assert len(again.folder.episodes.read_text().splitlines()) == 1
    assert again.folder.checkpoint.is_file()
    again.folder.checkpoint.unlink()
    assert create(tmp_path / 'run', gamma=0.5).settings.gamma == 0.5


def test_a_run_whose_checkpoint_was_removed_is_not_begun_again(run):
    run.checkpoint.unlink()
    rows = run.episodes.read_bytes()
    with pytest.raises(RunError, match='holds a run already'):
        create(run.path)
    with pytest.raises(RunError, match='no such checkpoint'):
        open_training(run.path, tiny(), resume=True, device='cpu')
    assert run.episodes.read_bytes() == rows


def test_a_place_that_cannot_be_written_is_one_line():
    with pytest.raises(RunError, match='/proc cannot be written: '):
        RunFolder('/proc').check_writable()
    with pytest.raises(BridgeError, match='/proc/run'):
        create('/proc/run')


def test_resume_point_says_what_a_resume_would(run):
    assert resume_point(run.path, tiny()) == (4, 60, {})
    with pytest.raises(RunError, match='hidden is 16, not 8'):
        resume_point(run.path, tiny(hidden=16))
    record = json.loads(run.record.read_text())
    assert len(record['sessions']) == 1


def test_a_copy_without_the_replay_is_small_and_goes_on(run, tmp_path):
    # of a tiny network on tiny observations: those of a real one are all of it but some MB
    size = sum(path.stat().st_size for path in run.checkpoint.parent.iterdir())
    before = {path: path.read_bytes() for path in run.path.rglob('*') if path.is_file()}
    copy_without_replay(run.path, tmp_path / 'copy')
    assert {path: path.read_bytes() for path in run.path.rglob('*') if path.is_file()} == before
    copied = RunFolder(tmp_path / 'copy')
    assert [path.name for path in copied.checkpoint.parent.iterdir()] == [copied.checkpoint.name]
    assert copied.checkpoint.stat().st_size < 0.7 * size
    own, other = resume(run), resume(copied)
    assert (other.decisions, other.episodes, other.learning.epsilon) == (
        own.decisions, own.episodes, own.learning.epsilon)
    for name, tensor in own.learning.learner.state_tensors().items():
        assert torch.equal(tensor, other.learning.learner.state_tensors()[name])
    updates, starts = other.learning.learner.updates, other.settings.learning_starts
    drive(other, stream(starts, seed=5))
    assert other.learning.learner.updates == updates and len(other.learning.replay) < 2 * starts
    drive(other, stream(40, seed=6))
    assert other.learning.learner.updates > updates
    other.save()
    assert resume(copied).decisions == own.decisions + starts + 40


@pytest.mark.parametrize('where', ['there', 'run/copy', '/proc/nowhere'])
def test_a_copy_that_cannot_be_made_is_one_line(run, tmp_path, where, capsys):
    (tmp_path / 'there').mkdir()
    assert without_replay_main([str(run.path), str(tmp_path / where)]) == 2
    assert capsys.readouterr().err.count('\n') == 1
    assert without_replay_main([str(tmp_path / 'there'), str(tmp_path / 'new')]) == 2
    # half a copy is none
    run.checkpoint.write_bytes(run.checkpoint.read_bytes()[:-1])
    assert without_replay_main([str(run.path), str(tmp_path / 'new')]) == 2
    assert not (tmp_path / 'new').exists()


def test_two_processes_do_not_learn_into_one_folder(run):
    code = ('import sys\nfrom trainer_node.run_folder import RunFolder\n'
            'RunFolder(sys.argv[1]).lock()\nprint("locked", flush=True)\nsys.stdin.read()')
    other = subprocess.Popen([sys.executable, '-c', code, str(run.path)],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        other.stdout.readline()
        rows = run.episodes.read_bytes()
        for resumed in (True, False):
            with pytest.raises(RunError, match='another process learns into it'):
                open_training(run.path, tiny(), resume=resumed, device='cpu')
        assert run.episodes.read_bytes() == rows
    finally:
        other.kill()
        other.communicate()
    # it ends with its process, however that ends; the same process may open it again
    for _ in range(2):
        run.lock()


def test_a_new_run_has_bfloat16_where_the_machine_has_or_it_is_asked_for(run, monkeypatch):
    for has in (True, False):
        monkeypatch.setattr(open_run, 'computes_bfloat16', lambda has=has: has)
        assert run_settings('new', 'racing', {}, resume=False).bf16 == has
        assert run_settings('new', 'racing', {'bf16': True}, resume=False).bf16
        assert not run_settings('new', 'report', {}, resume=False).bf16
        # what a run began with it goes on with
        text = run.config.read_text()
        for begun in ('true', 'false'):
            run.config.write_text(re.sub('bf16: .*', f'bf16: {begun}', text))
            assert str(run_settings(run.path, 'racing', {}, resume=True).bf16).lower() == begun


def test_the_last_stamps_that_ros_can_say_are_gone_on_from(tmp_path):
    """Nobody refuses nanoseconds beyond a second; who saves them has to read them."""
    last = (2**31 - 1) * 10**9 + 2**32 - 1
    training = create(tmp_path / 'run')
    first, *_ = stream(1)
    training.add(dataclasses.replace(first, stamp=last - 1, next_stamp=last))
    training.save()
    later = Training.resume(tmp_path / 'run', device='cpu')
    assert later.learning.state().segment_end == last


@pytest.mark.parametrize('taken', ['checkpoint', 'episodes.csv'])
def test_what_stands_in_the_way_of_beginning_anew_is_one_line(tmp_path, taken):
    begun = create(tmp_path / 'run')
    begun.folder.checkpoint.unlink()
    place = tmp_path / 'run' / taken
    if taken == 'checkpoint':
        place.rmdir()
        place.write_text('')
    else:
        place.unlink()
        place.mkdir()
    with pytest.raises(RunError, match=f'run/{taken}: '):
        open_training(tmp_path / 'run', tiny(), resume=False, device='cpu')


def test_of_two_processes_that_begin_a_run_at_the_same_moment_one_is_refused(tmp_path):
    code = ('import sys\n'
            'from learning_cases import tiny\n'
            'from msgs_bridge.errors import BridgeError\n'
            'from trainer_node.open_run import open_training\n'
            'from trainer_node.training import Training\n'
            'print("ready", flush=True)\n'
            'sys.stdin.readline()\n'
            'try:\n'
            '    open_training(sys.argv[1], tiny(gamma=float(sys.argv[2])), resume=False,'
            ' device="cpu")\n'
            '    print("learns", flush=True)\n'
            'except BridgeError as error:\n'
            '    print(error, flush=True)\n'
            'sys.stdin.readline()\n')
    gammas = ('0.5', '0.6')
    both = [subprocess.Popen(
        [sys.executable, '-c', code, str(tmp_path / 'run'), gamma], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}) for gamma in gammas]
    try:
        for one in both:
            assert one.stdout.readline() == 'ready\n'
        for one in both:
            one.stdin.write('\n')
            one.stdin.flush()
        said = [one.stdout.readline().strip() for one in both]
        winner = said.index('learns')
        assert re.search('another process learns into it|holds a run already', said[1 - winner])
        # and what there is, is of the one that learns
        assert run_settings(tmp_path / 'run', 'racing', {}, resume=True).gamma == float(
            gammas[winner])
        assert Training.resume(tmp_path / 'run', device='cpu').settings.gamma == float(
            gammas[winner])
    finally:
        for one in both:
            one.kill()
            one.communicate()


@pytest.mark.skipif(Path('/proc/sys/vm/overcommit_memory').read_text().strip() == '1',
                    reason='this system promises any memory')
def test_a_replay_that_the_machine_has_no_memory_for_is_one_line(tmp_path):
    with pytest.raises(BridgeError, match='a replay of 5000000 observations of 4096x4096 takes '
                                          '78125 GiB.*set replay_capacity lower'):
        open_training(tmp_path / 'run', tiny(
            frame_height=4096, frame_width=4096, shrink=1, convolutions='4@32/16 4@32/16',
            replay_capacity=5_000_000), resume=False, device='cpu')
    assert not (tmp_path / 'run').exists()
