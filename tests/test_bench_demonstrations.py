# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of demonstrations: its stand-in finishes laps, and it goes on where it was."""
import json

from carracing_dqn.benchmarks.bench_demonstrations import decisions_to, main, scripted_laps


def test_the_stand_in_for_a_person_finishes_a_lap():
    lap = list(scripted_laps(1))
    last = lap[-1].step
    assert last.info['lap_finished'] == 1 and last.episode_return > 850
    assert lap[0].next_stamp - lap[0].stamp == 20_000_000
    assert all(max(map(abs, one.command)) <= 1 for one in lap)
    # another time it is the same lap
    assert [one.command for one in scripted_laps(1)] == [one.command for one in lap]


def test_the_benchmark_drives_both_and_goes_on(tmp_path, capsys):
    words = ['--laps', '1', '--seeds', '1', '--decisions', '40', '--every', '20', '--tracks', '1',
             '--output', str(tmp_path), '--wanted', '-1000', '10000', '--set',
             'convolutions=4@8/4', 'hidden=8', 'shrink=4', 'learning_starts=10',
             'demonstration_updates=3', 'replay_capacity=200', 'epsilon_end=0.05']
    assert main(words) == 0
    shown, plain = map(json.loads, capsys.readouterr().out.splitlines())
    assert (shown['arm'], plain['arm']) == ('demonstrations', 'plain')
    assert '1 episodes' in shown['demonstrations'] and 'demonstrations' not in plain
    for found in (shown, plain):
        # the first before anything was driven, the last ones of the last weights
        assert [row['decisions'] for row in found['validations']] == [0, 20, 40, 40]
        assert found['decisions_to'] == {'-1000': 0, '10000': None}
    record = json.loads((tmp_path / 'demonstrations-1' / 'run.json').read_text())
    assert record['complete'] and record['demonstrations']['foreign'] == 0
    assert main(words) == 0
    again = capsys.readouterr().out.splitlines()
    assert list(map(json.loads, again)) == [shown, plain]


def test_what_was_never_reached_is_said():
    rows = [{'decisions': 0.0, 'mean': 5.0}, {'decisions': 10.0, 'mean': 50.0}]
    assert decisions_to(rows, 5) == 0 and decisions_to(rows, 6) == 10
    assert decisions_to(rows, 60) is None
