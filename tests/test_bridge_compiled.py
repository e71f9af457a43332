# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled code is kept where only the user can write, and a bad file of it costs time only."""
import hashlib
import importlib.util
import os
from pathlib import Path
import pickle
import shutil
import warnings

from msgs_bridge.compiled import cache_folder
import pytest

SOURCE = """
from msgs_bridge.compiled import compiled

@compiled
def twice(number):
    return 2 * number
"""


class Trap:
    """A pickle that runs code when it is read."""

    def __init__(self, sign: Path) -> None:
        self.sign = sign

    def __reduce__(self):
        return os.mkdir, (str(self.sign),)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return the user's cache folder, made private whatever the umask."""
    monkeypatch.delenv('NUMBA_CACHE_DIR', raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    for name in ('cache', 'temporary'):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path / 'temporary'))
    (tmp_path / 'loops.py').write_text(SOURCE)
    yield tmp_path / 'cache' / 'carracing_dqn'
    cache_folder.cache_clear()


def start(folder: Path, meanwhile=lambda: None) -> bool:
    """Do what a new process does; return whether it found the function compiled."""
    cache_folder.cache_clear()
    spec = importlib.util.spec_from_file_location('loops', folder / 'loops.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    meanwhile()
    assert module.twice(21) == 42
    return sum(module.twice.stats.cache_hits.values()) == 1


def kept(place: Path) -> list[Path]:
    return sorted(path for path in place.rglob('*') if path.is_file())


def trap_pickle(place: Path) -> bytes:
    return pickle.dumps(Trap(place.parent.parent / 'code_ran'))


def code_ran(place: Path) -> bool:
    return (place.parent.parent / 'code_ran').exists()


def test_a_second_start_finds_what_was_compiled_in_a_folder_of_the_user_alone(place, tmp_path):
    assert not start(tmp_path)
    assert start(tmp_path)
    assert [path.suffix for path in kept(place)] == ['.nbc', '.nbi']
    assert place.stat().st_mode & 0o777 == 0o700
    assert not list(tmp_path.glob('__pycache__/*.nb?'))


def test_another_source_is_compiled_anew(place, tmp_path):
    start(tmp_path)
    (tmp_path / 'loops.py').write_text(SOURCE.replace('2 * number', 'number + number'))
    assert not start(tmp_path)


@pytest.mark.parametrize('suffix', ['.nbi', '.nbc'])
@pytest.mark.parametrize('damage', [
    lambda content: b'', lambda content: content[:40], lambda content: content[:-1],
    lambda content: content[:99] + bytes([content[99] ^ 1]) + content[100:],
], ids=['empty', 'cut', 'end cut off', 'one bit'])
def test_a_damaged_file_is_replaced(place, tmp_path, suffix, damage):
    start(tmp_path)
    file = next(path for path in kept(place) if path.suffix == suffix)
    file.write_bytes(damage(file.read_bytes()))
    assert not start(tmp_path)
    assert start(tmp_path)


def test_planted_pickles_are_not_read(place, tmp_path):
    start(tmp_path)
    beside = tmp_path / '__pycache__'
    beside.mkdir(exist_ok=True)
    for path in kept(place):
        path.write_bytes(trap_pickle(place))
        (beside / path.name).write_bytes(trap_pickle(place))
    assert not start(tmp_path)
    assert not code_ran(place)


def test_a_folder_within_that_others_may_write_in_is_not_read(place, tmp_path):
    start(tmp_path)
    inner, = place.iterdir()
    inner.chmod(0o777)
    # a hash is no secret
    for path in kept(place):
        path.write_bytes(trap_pickle(place) + hashlib.sha256(trap_pickle(place)).digest())
    assert not start(tmp_path)
    assert not code_ran(place)


def others_may_write_in_it(place):
    place.chmod(0o777)


def others_may_replace_it(place):
    place.parent.chmod(0o770)


def another_users(place):
    if os.geteuid() != 0:
        pytest.skip('only root can give a folder away')
    os.chown(place, 12345, 12345)


def a_link_to_where_others_write(place):
    shared = place.parent.parent / 'shared'
    place.rename(shared)
    shared.chmod(0o777)
    place.symlink_to(shared)


@pytest.mark.parametrize('spoil', [
    others_may_write_in_it, others_may_replace_it, another_users, a_link_to_where_others_write])
def test_nothing_is_read_where_others_can_write(place, tmp_path, spoil):
    start(tmp_path)
    content = trap_pickle(place)
    for path in kept(place):
        path.write_bytes(content + hashlib.sha256(content).digest())
    spoil(place)
    # a folder of the user alone among the temporary ones takes its place
    assert [start(tmp_path), start(tmp_path)] == [False, True]
    assert not code_ran(place)


@pytest.mark.parametrize('planted', ['link', 'writable'])
def test_a_user_without_any_place_compiles_every_time(place, tmp_path, monkeypatch, planted):
    folder = tmp_path / 'temporary' / f'carracing_dqn_{os.getuid()}'
    (tmp_path / 'own').mkdir(mode=0o700)
    if planted == 'link':
        folder.symlink_to(tmp_path / 'own')
    else:
        folder.mkdir()
        folder.chmod(0o777)
    monkeypatch.delenv('XDG_CACHE_HOME')
    for home in ('/dev/null/home', '/proc'):
        monkeypatch.setenv('HOME', home)
        with pytest.warns(RuntimeWarning, match='some seconds more'):
            assert not start(tmp_path)
    # a place that the user has named serves as well
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'own'))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert [start(tmp_path), start(tmp_path)] == [False, True]


def test_a_folder_that_goes_away_before_anything_is_kept_is_made_again(place, tmp_path):
    assert not start(tmp_path, meanwhile=lambda: shutil.rmtree(place))
    assert start(tmp_path)
