# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the learner runs and counts its arithmetic right."""
import json

from carracing_dqn.benchmarks import bench_learner
from carracing_dqn.benchmarks.bench_learner import main, nature, update_operations
from learning_cases import tiny


def test_operations_of_the_nature_network_by_hand():
    forward = (20 * 20 * 32 * 4 * 64 + 9 * 9 * 64 * 32 * 16 + 7 * 7 * 64 * 64 * 9
               + 3136 * 512 + 512 * 5)
    first = 20 * 20 * 32 * 4 * 64
    description = nature(bf16=True).model_description()
    assert update_operations(description, 32, double=False) == 2 * 32 * (4 * forward - first)
    assert update_operations(description, 32, double=True) == 2 * 32 * (5 * forward - first)


def test_the_benchmark_writes_its_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench_learner, 'HELD', 100)
    monkeypatch.setattr(bench_learner, 'MATRIX', 64)
    monkeypatch.setattr(bench_learner, 'stable_baselines', lambda decisions: None)
    monkeypatch.setattr(bench_learner, 'nature', lambda bf16: tiny(bf16=bf16))
    assert main(['--rounds', '1', '--updates', '1', '--after', '2', '--calls', '--json', str(
        tmp_path / 'b.json')]) == 0
    figures = json.loads((tmp_path / 'b.json').read_text())
    assert figures['updates_per_second']['racing preset'] > 0
    # of three convolutions three passes forward, because of Double, and one backward
    racing = figures['calls']['racing preset']
    assert racing['convolutions backward'][1] == 3
    assert racing['convolutions forward'][1] >= 9
    assert all(racing[kind][0] > 0 for kind in racing)
    told = capsys.readouterr().out
    assert 'pip install stable-baselines3' in told
    assert 'convolutions backward' in told
