# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Shared memory of dead processes goes, that of living ones stays: real participants."""
import os
from pathlib import Path
import re
import subprocess
import sys
import time

from msgs_bridge.dead_segments import OLD_ENOUGH, remove_dead_segments, SHARED_MEMORY
import pytest

NODE = """
import os, re, sys, rclpy
rclpy.init()
node = rclpy.create_node('segment_owner')
maps = open('/proc/self/maps').read()
print(*sorted(set(re.findall('/dev/shm/(fastrtps_[0-9a-f]{16})', maps))), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def owner():
    """A process with a segment of its own, and the segment's name."""
    process = subprocess.Popen([sys.executable, '-c', NODE], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True)
    names = process.stdout.readline().split()
    if not names:
        process.kill()
        pytest.skip('the middleware uses no shared memory here')
    # as if it had been there for a while
    old = time.time() - OLD_ENOUGH - 1
    for name in names:
        os.utime(SHARED_MEMORY / f'{name}_el', (old, old))
    yield process, names
    process.kill()
    process.wait()
    for name in names:
        for path in (SHARED_MEMORY / name, SHARED_MEMORY / f'{name}_el'):
            path.unlink(missing_ok=True)


def left(names) -> set[str]:
    return {path.name for path in SHARED_MEMORY.iterdir() for name in names
            if re.fullmatch(f'{name}(_el)?', path.name)}


def test_a_living_process_keeps_its_segment_and_a_killed_one_does_not(owner):
    process, names = owner
    both = {*names, *(f'{name}_el' for name in names)}
    remove_dead_segments()
    assert left(names) == both
    process.kill()
    process.wait()
    assert left(names) == both
    assert remove_dead_segments() >= len(names)
    assert left(names) == set()


def test_what_is_young_or_not_of_fast_dds_stays(tmp_path):
    (tmp_path / 'fastrtps_0123456789abcdef').write_text('segment')
    (tmp_path / 'fastrtps_0123456789abcdef_el').write_text('')
    (tmp_path / 'fastrtps_port7411_el').write_text('')
    (tmp_path / 'another_el').write_text('')
    (tmp_path / 'fastrtps_fedcba9876543210_el').symlink_to(tmp_path / 'another_el')
    assert remove_dead_segments(tmp_path) == 0
    assert remove_dead_segments(tmp_path, old_enough=-1.0) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'another_el', 'fastrtps_fedcba9876543210_el', 'fastrtps_port7411_el']
    assert remove_dead_segments(Path('/nowhere')) == 0
