# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files of laps: whole, resumable, never mixed up."""
import argparse
import csv
import json
import math
import os
from pathlib import Path
import time

from carracing_dqn.bringup.command import main as carracing
from carracing_dqn.evaluation import evaluate_command, kept_laps
from carracing_dqn.evaluation.errors import EvaluationError, ResultsError
from carracing_dqn.evaluation.kept_laps import keep_laps
from carracing_dqn.evaluation.policies import PolicySource
from carracing_dqn.evaluation.results import (
    COLUMNS, locked, read_json, resume, write_csv, write_json,
)
from evaluation_cases import lap, results
import pytest
from rich.console import Console

POLICY = {'kind': 'model', 'name': 'model'}


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """Laps are kept below the current folder when nothing else is said."""
    monkeypatch.chdir(tmp_path)


def too_large(frame):
    """Be a policy whose number fits no float."""
    return 10**400, 0.0


class _Unreadable:
    def __iter__(self):
        raise RuntimeError('not to be read')


def unreadable(frame):
    """Be a policy whose answer fails when it is looked at."""
    return _Unreadable()


class Seldom:
    """A policy that does not say how often it acts."""

    action_repeat = None

    def act(self, frame):
        """Return an action."""
        return 0.0, 0.0


def evaluate(*words):
    return carracing(['evaluate', '--simulator', 'fast', '--processes', '1', *map(str, words)])


def test_json_is_read_back_as_it_was(tmp_path):
    written = results([700, 812.5, 930], lap_finished=True)
    write_json(tmp_path / 'r.json', written)
    assert read_json(tmp_path / 'r.json') == written
    values = json.loads((tmp_path / 'r.json').read_text())
    assert values['complete'] is True
    assert values['statistics']['mean'] == pytest.approx(814.1666667)
    assert values['statistics']['success'] == {'700': 1.0, '800': 2 / 3, '900': 1 / 3}


def test_csv_has_a_row_a_lap(tmp_path):
    write_csv(tmp_path / 'r.csv', results([700, 930]))
    header, *rows = csv.reader((tmp_path / 'r.csv').open())
    assert tuple(header) == COLUMNS
    assert rows[1] == ['100001', '930.0', '1000', '270', '300', '0', '0', '0', '1.0']


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'not JSON'), ('[]', 'not a file of carracing evaluate'), ('{"laps": 1}', 'not a file'),
    ('{"format": "carracing_dqn evaluation 1"}', 'damaged'),
    ('{"format": "carracing_dqn evaluation 1", "laps": [{"seed": 1}]}', 'damaged'),
    ('{"format": "carracing_dqn evaluation 1", "laps": 5}', 'damaged'),
])
def test_a_file_that_is_something_else_is_named(tmp_path, text, message):
    (tmp_path / 'r.json').write_text(text)
    with pytest.raises(ResultsError, match=message):
        read_json(tmp_path / 'r.json')


def test_a_lap_with_a_missing_or_wrong_value_is_damage(tmp_path):
    write_json(tmp_path / 'r.json', results([700]))
    values = json.loads((tmp_path / 'r.json').read_text())
    for change in (
            {'episode_return': None}, {'tiles_total': 0}, {'frames': 'many'},
            {'episode_return': math.nan}, {'episode_return': math.inf}, {'frames': math.inf},
            {'frames': 10**400}, {'frames': 2**53 + 1}, {'seed': 1.5}, {'seed': True},
            {'tiles_visited': None},
            {'tiles_visited': 301}, {'tiles_visited': -1}, {'lap_finished': 2}):
        laps = [values['laps'][0] | change]
        (tmp_path / 'r.json').write_text(json.dumps({**values, 'laps': laps}))
        with pytest.raises(ResultsError, match='damaged'):
            read_json(tmp_path / 'r.json')


@pytest.mark.parametrize('change', [
    {'policy': [[1, 2]]}, {'policy': None}, {'machine': [['a', 1]]}, {'simulator': 5},
    {'wanted': -1}, {'wanted': 1.5}, {'wanted': 10**400}, {'seconds': math.nan},
    {'seconds': math.inf}, {'seconds': '1'}, {'seconds': 10**400}, {'simulator_source': 1}])
def test_what_is_said_of_laps_is_of_its_kind_or_damage(tmp_path, change):
    write_json(tmp_path / 'r.json', results([700]))
    values = json.loads((tmp_path / 'r.json').read_text())
    (tmp_path / 'r.json').write_text(json.dumps(values | change))
    with pytest.raises(ResultsError, match='damaged'):
        resume(tmp_path / 'r.json', POLICY, 'gymnasium', range(100_000, 100_010))


def test_a_seed_that_comes_twice_is_damage(tmp_path):
    write_json(tmp_path / 'r.json', results([700]))
    values = json.loads((tmp_path / 'r.json').read_text())
    (tmp_path / 'r.json').write_text(json.dumps({**values, 'laps': 2 * values['laps']}))
    with pytest.raises(ResultsError, match='a seed comes twice'):
        read_json(tmp_path / 'r.json')


def test_a_file_that_never_ends_is_refused(tmp_path):
    os.mkfifo(tmp_path / 'r.json')
    with pytest.raises(ResultsError, match='not a regular file'):
        read_json(tmp_path / 'r.json')


def test_laps_of_another_policy_are_not_gone_on_with(tmp_path):
    made = results([700])
    made.policy = {'kind': 'custom', 'name': 'mine:drive'}
    write_json(tmp_path / 'r.json', made)
    seeds = range(100_000, 100_010)
    assert resume(tmp_path / 'r.json', made.policy, 'gymnasium', seeds).laps
    with pytest.raises(ResultsError, match="name is 'mine:drive' there, 'mine:park' here"):
        resume(tmp_path / 'r.json', {**made.policy, 'name': 'mine:park'}, 'gymnasium', seeds)


def test_laps_of_code_that_has_changed_since_are_not_gone_on_with(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    toy = Path(__file__).with_name('toy_simulator.py').read_text()
    Path('driver_of_mine.py').write_text('def drive(frame):\n    return 0.0, 0.0\n')
    Path('world_of_mine.py').write_text(toy)
    Path('toy.yaml').write_text('simulator: world_of_mine:Toy\n')
    words = {
        'driver_of_mine.py': ('--policy', 'driver_of_mine:drive', '--simulator', 'fast'),
        'world_of_mine.py': ('--policy', 'random', '--simulator', 'world_of_mine:Toy'),
        'toy.yaml': ('--policy', 'random', '--simulator', 'toy.yaml')}
    for changed, (policy, name, simulator, world) in words.items():
        path = Path('r.json')
        words = ['evaluate', policy, name, simulator, world, '--episodes', '1', '--processes',
                 '1', '--json', str(path)]
        assert carracing(words) == 0, capsys.readouterr().err
        assert carracing(words) == 0 and '1 of 1 laps are in' in capsys.readouterr().out
        Path(changed).write_text(Path(changed).read_text() + '# another one\n')
        assert carracing(words) == 2
        assert 'source' in capsys.readouterr().err, changed
        # files of an older version do not say it of the simulator
        values = json.loads(path.read_text())
        del values['simulator_source']
        path.write_text(json.dumps(values))
        assert carracing(words) == (2 if name == 'driver_of_mine:drive' else 0)
        path.unlink()


def test_what_only_driven_laps_give_is_not_promised_of_others(tmp_path, capsys):
    path = tmp_path / 'r.json'
    words = ('--policy', 'random', '--episodes', 1, '--seed', 5, '--json', path)
    assert evaluate(*words) == 0
    assert evaluate(*words, '--pictures', tmp_path / 'pictures') == 2
    assert '1 of the laps in' in capsys.readouterr().err
    assert not (tmp_path / 'pictures').exists()
    path.unlink()
    assert evaluate(*words, '--pictures', tmp_path / 'pictures') == 0
    assert evaluate(*words, '--pictures', tmp_path / 'pictures') == 0
    made = results([700])
    made.policy, made.simulator = PolicySource('random').identity(), 'graph'
    write_json(path, made)
    assert carracing(['evaluate', '--policy', 'random', '--episodes', '1', '--json', str(path),
                      '--through-graph', '--bag', str(tmp_path / 'bag')]) == 2
    assert '--bag: all laps are in' in capsys.readouterr().err


def test_thousands_of_laps_are_not_written_after_each_and_none_is_lost(tmp_path, monkeypatch):
    written = []
    made = results([700])

    def slow():
        time.sleep(0.02)
        written.append(len(made.laps))

    def drive(fails):
        for seed in range(100):
            time.sleep(0.001)
            yield lap(seed, 1.0)
        if fails:
            raise EvaluationError('no more')

    monkeypatch.setattr(kept_laps, 'QUICK_SECONDS', 0.01)
    keep_laps(drive(fails=False), made, Console(), slow)
    assert written[0] == 2 and written[-1] == 101 and len(written) < 50
    made.laps.clear()
    with pytest.raises(EvaluationError, match='no more'):
        keep_laps(drive(fails=True), made, Console(), slow)
    assert written[-1] == 100


def test_two_commands_do_not_write_laps_into_one_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(evaluate_command.time, 'strftime', lambda _: 'now')
    with locked('r.json'):
        assert evaluate('--policy', 'random', '--episodes', 1, '--json', 'r.json') == 2
    assert 'r.json: another process writes its laps there' in capsys.readouterr().err
    Path('runs').mkdir()
    with locked('runs/evaluate-random-now.json'):
        assert evaluate('--policy', 'random', '--episodes', 1) == 0
    assert os.listdir('runs') == ['evaluate-random-now-1.json']
    assert os.listdir() == ['runs']


def test_laps_of_another_evaluation_are_not_gone_on_with(tmp_path):
    path = tmp_path / 'r.json'
    write_json(path, results([700, 800]))
    seeds = range(100_000, 100_010)
    assert list(resume(path, POLICY, 'gymnasium', seeds).laps) == [100_000, 100_001]
    assert resume(tmp_path / 'other.json', POLICY, 'gymnasium', seeds).laps == {}
    with pytest.raises(ResultsError, match="simulator is 'gymnasium' there, 'fast' here"):
        resume(path, POLICY, 'fast', seeds)
    with pytest.raises(ResultsError, match='weights_sha256 is None there'):
        resume(path, {**POLICY, 'weights_sha256': 'abc'}, 'gymnasium', seeds)
    with pytest.raises(ResultsError, match='2 laps of other seeds'):
        resume(path, POLICY, 'gymnasium', range(5))


def test_an_evaluation_goes_on_where_it_stopped(tmp_path, capsys):
    whole, part = tmp_path / 'whole.json', tmp_path / 'part.json'
    assert evaluate('--policy', 'random', '--episodes', 3, '--json', whole) == 0
    assert evaluate('--policy', 'random', '--episodes', 1, '--json', part) == 0
    assert evaluate('--policy', 'random', '--episodes', 3, '--json', part,
                    '--csv', tmp_path / 'part.csv') == 0
    assert '1 of 3 laps are in' in capsys.readouterr().out
    assert read_json(part).laps == read_json(whole).laps
    assert len((tmp_path / 'part.csv').read_text().splitlines()) == 4
    before = read_json(part).seconds
    assert evaluate('--policy', 'random', '--episodes', 3, '--json', part) == 0
    assert read_json(part).seconds == before


def test_ctrl_c_keeps_the_laps(tmp_path, monkeypatch, capsys):
    def interrupted(source, seeds, **_):
        yield from list(results([700, 800]).laps.values())
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate_command, 'drive_laps', interrupted)
    path = tmp_path / 'r.json'
    assert evaluate('--policy', 'random', '--json', path) == 130
    assert 'stopped after 2 of 100 laps' in capsys.readouterr().err
    assert len(read_json(path).laps) == 2
    assert json.loads(path.read_text())['complete'] is False


def test_ctrl_c_in_the_middle_of_writing_loses_no_lap(tmp_path, monkeypatch):
    write, calls = evaluate_command.write_json, []

    def interrupted(path, found):
        calls.append(path)
        if len(calls) == 2:
            raise KeyboardInterrupt
        write(path, found)

    monkeypatch.setattr(evaluate_command, 'write_json', interrupted)
    monkeypatch.setattr(evaluate_command, 'drive_laps',
                        lambda *_, **__: (lap for lap in results([700, 800]).ordered))
    assert evaluate('--policy', 'random', '--json', 'r.json') == 130
    assert len(read_json('r.json').laps) == 2


def test_laps_are_kept_without_being_asked_for(tmp_path, monkeypatch, capsys):
    def interrupted(source, seeds, **_):
        yield from list(results([700, 800]).laps.values())
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate_command, 'drive_laps', interrupted)
    assert evaluate('--policy', 'random') == evaluate('--policy', 'random') == 130
    first, second = sorted((tmp_path / 'runs').iterdir())
    assert len(read_json(first).laps) == len(read_json(second).laps) == 2
    said = capsys.readouterr().err.splitlines()
    assert any(line.endswith(f'--json runs/{first.name} goes on') for line in said)


def test_laps_of_the_model_of_a_run_are_kept_with_the_run(tmp_path):
    (tmp_path / 'run' / 'best').mkdir(parents=True)
    source = PolicySource('model', str(tmp_path / 'run' / 'best'))
    assert source.run_folder is None
    (tmp_path / 'run' / 'episodes.csv').touch()
    assert next(evaluate_command._new_files(source)).parent == tmp_path / 'run'


def test_a_place_that_cannot_be_written_is_said_before_anything_is_driven(monkeypatch, capsys):
    monkeypatch.setattr('os.access', lambda *_: False)
    monkeypatch.setattr(evaluate_command, 'drive_laps', None)
    assert evaluate('--policy', 'random') == 2
    assert 'cannot be written' in capsys.readouterr().err


@pytest.mark.parametrize(('words', 'message'), [
    (['--model', 'racing', '--policy', 'random'], 'only one can drive'),
    (['--episodes', 0], 'episodes is 0'), (['--processes', 0], 'processes is 0'),
    (['--episodes', 2**31], 'episodes is 2147483648; accepted: 1 to 100000'),
    (['--processes', 10**9], 'processes is 1000000000; accepted: 1 to'),
    (['--through-graph', '--simulator', 'racetrack'], 'and not in racetrack'),
    (['--csv', '/dev/null'], '/dev/null cannot be written: it is no file'),
    (['--json', '/dev/null'], '/dev/null cannot be written: it is no file'),
    (['--json', './r.csv', '--csv', 'r.csv'], 'are both r.csv'),
    (['--seed', -1], 'seed is -1'), (['--seed', 2**31], 'seed is'),
    (['--action-repeat', 51], 'action-repeat is 51'), (['--action-repeat', 2], 'for models'),
    (['--device', 'cuda'], '--device is for models'),
    (['--through-graph'], '--processes is for laps in process'),
    (['--bag', 'x'], 'through-graph'), (['--json', '/no/such/folder/r.json'], 'no folder'),
    (['--policy', 'me'], 'accepted:'),
    (['--policy', 'evaluation_cases:not_finite'], 'answered (nan'),
    (['--policy', 'evaluation_cases:fail'], 'failed in act: RuntimeError: a fault of its own'),
    (['--policy', 'evaluation_cases:leave'], 'failed in act: SystemExit: 0'),
    (['--policy', f'{__name__}:too_large'], 'answered (1000'),
    (['--policy', f'{__name__}:unreadable'], 'failed in act: RuntimeError: not to be read'),
    (['--policy', f'{__name__}:Seldom'], 'failed in action_repeat: TypeError'),
    (['--policy', 'evaluation_cases:Unmade'], 'failed in its making: OSError: no hands'),
    (['--model', 'no_such_model'], 'no_such_model'),
])
def test_bad_options_are_one_line_and_code_2(words, message, capsys, tmp_path):
    words = words if '--policy' in words or '--model' in words else [*words, '--policy', 'random']
    assert evaluate('--csv', tmp_path / 'r.csv', *words) == 2
    error = capsys.readouterr().err
    assert error.startswith('error: ') and message in error and error.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_named(tmp_path, capsys):
    (tmp_path / 'r.csv').mkdir()
    assert evaluate('--policy', 'random', '--episodes', 1, '--csv', tmp_path / 'r.csv') == 2
    assert 'cannot be written' in capsys.readouterr().err


def test_the_command_alone_has_no_graph():
    parser = argparse.ArgumentParser()
    evaluate_command.add_arguments(parser)
    arguments = parser.parse_args(['--policy', 'random', '--through-graph', '--episodes', '1'])
    with pytest.raises(EvaluationError, match='carracing command'):
        evaluate_command.main(arguments)
