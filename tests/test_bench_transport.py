# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of transports: what it starts, and that both are heard."""
import json
import os

from carracing_dqn.benchmarks import bench_transport
import pytest


def test_both_transports_carry_small_images(tmp_path):
    before = dict(os.environ)
    assert bench_transport.main([
        '--size', '64x48', '--rate', '20', '--seconds', '1', '--readers', '1', '--rounds', '1',
        '--json', str(tmp_path / 'figures.json')]) == 0
    rounds = json.loads((tmp_path / 'figures.json').read_text())['rounds']
    assert len(rounds) == 4
    for of_one in rounds.values():
        assert 0 < of_one[0]['heard'] <= 1
    assert dict(os.environ) == before


@pytest.mark.parametrize('size', ['64', 'x48', '64x', '6 x y'])
def test_a_size_that_is_none_is_refused(size, capsys):
    with pytest.raises(SystemExit):
        bench_transport.main(['--size', size])
    assert '--size' in capsys.readouterr().err
