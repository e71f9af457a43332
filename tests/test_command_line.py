# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The command in one process: help, wrong input, and errors of the system, each in a line."""
import errno
import io
import re
import shutil
import subprocess
import sys

from carracing_dqn.bringup import command
from carracing_dqn.bringup.command import main
from carracing_dqn.bringup.curve import Curve, MOST_POINTS, past_returns
from carracing_dqn.bringup.display import Display
from carracing_dqn.bringup.models import as_parameter, choose_model
from carracing_dqn.bringup.monitor import GraphState
from carracing_dqn.bringup.run_command import laps_line, laps_table
from carracing_dqn.bringup.training_display import training_line, training_table
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.policies import model_source
from carracing_dqn.evaluation.progress import LapProgress
from carracing_dqn.bringup.graph import POLICY, SIMULATOR, TRAINER
from carracing_dqn.watch.painting import spark
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from dqn_policy_node import load_policy
from dqn_policy_node.shipped_models import find_model, RANDOM
from msgs_bridge.settings import describe
from msgs_bridge.share import share_path
from msgs_bridge.step import EPISODE_CORE, VALIDATION_FIELDS
import pytest
from rich.console import Console
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.settings import TOO_SLOW


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, 'stop_on_signals', lambda: None)


@pytest.mark.parametrize(('words', 'told'), [
    (['rnu'], "invalid choice: 'rnu'"),
    (['run', '--lapz', '3'], 'unrecognized arguments: --lapz 3'),
    (['run', '--laps', 'x'], "invalid int value: 'x'"),
    (['run', '--laps', '-1'], '--laps is -1'),
    (['run', '--seed', '-1'], '--seed is -1'),
    (['run', '--namespace', '[/x]'], "--namespace is '[/x]'"),
    (['run', '--model', 'a\x1b[31m'], 'the shipped, which are mujoco_car, '),
    (['run', '--model', '../models/racing'], 'neither a folder with model.json'),
    (['train', '--minutes', '0'], '--minutes is 0'),
    (['train', '--minutes', '-1'], '--minutes is -1'),
    (['train', '--minutes', 'nan'], '--minutes is nan'),
    (['train', '--set', 'network=foo'], 'carracing train --list prints every name'),
    (['train', '--set', 'gamma=2'], 'gamma is 2.0; accepted: 0 to 1; carracing train --list'),
    (['train', '--set', 'gama=0.9'], "did you mean 'gamma'"),
    (['train', '--set', 'simulator=a,b.yaml'], 'a comma stands between settings and in none'),
    (['train', '--resume', 'x', '--preset', 'racing'], '--resume goes on in its own folder'),
    (['train', '--bag', '--from-bag', 'x'], '--bag records a graph'),
    (['train', '--from-bag', 'nowhere'], 'nowhere'),
    (['evaluate', '--model', 'racing', '--policy', 'random'], 'only one can drive'),
    (['evaluate', '--episodes', '-1'], '--episodes is -1'),
    (['report', 'nowhere'], 'nowhere'),
    (['bag'], 'required'),
    (['bench', 'nothing'], "invalid choice: 'nothing'"),
])
def test_wrong_input_is_one_line_and_leaves_nothing(words, told, capsys, tmp_path):
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.err.startswith('error: ') and told in said.err and said.err.count('\n') == 1
    assert said.err.rstrip('\n').isprintable() and not said.out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('words', [['--version'], ['--vers'], ['--version', 'run']])
def test_the_version_is_printed_whatever_follows(words, capsys):
    assert main(words) == 0
    assert capsys.readouterr().out.startswith('carracing ')


@pytest.mark.parametrize('term', ['dumb', 'unknown'])
def test_a_terminal_that_cannot_move_its_cursor_is_told_by_lines(monkeypatch, term):
    monkeypatch.setenv('TERM', term)
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with Display(GraphState(), laps_table, laps_line, console) as display:
        display.update()
        assert 'driving: starting' in console.file.getvalue()
    with LapProgress([], 2, console) as progress:
        progress.add(Lap(5, 900.0, 700))
        assert 'lap 1 of 2' in console.file.getvalue()


def test_tensorboard_is_missed_before_anything_is_made(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'tensorboard', None)
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    assert main(['train', '--tensorboard']) == 2
    assert 'pip install tensorboard' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_without_words_there_is_help(capsys):
    assert main([]) == 0
    said = capsys.readouterr().out
    assert all(f'\n    {name} ' in said for name in command.SUBCOMMANDS)


def test_the_list_has_every_hyperparameter_with_what_it_accepts(capsys):
    assert main(['train', '--list', '--preset', 'report', '--set', 'gamma=0.5']) == 0
    lines = capsys.readouterr().out.splitlines()
    listed = {match[1]: match[2] for match in map(
        re.compile(r'(\w+)=.*  \((.*)\)$').match, lines) if match}
    known = describe(Hyperparameters)
    assert list(listed) == list(known)
    assert 'gamma=0.5  (0 to 1)' in lines and listed['double'] == 'true or false'


def test_a_reader_that_goes_is_told_apart_from_a_failure():
    # through rich, which ends with 1 by itself
    done = subprocess.run(
        ['bash', '-c', 'set -o pipefail; "$@" | true', 'bash', sys.executable, '-m',
         'carracing_dqn.bringup', 'train', '--list'], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (141, '')


@pytest.mark.parametrize(('error', 'code', 'told'), [
    (OSError(errno.ENOSPC, 'No space left on device', 'runs/x'),
     2, 'error: runs/x: No space left on device\n'),
    (PermissionError(errno.EACCES, 'Permission denied'), 2, 'error: Permission denied\n'),
    (MemoryError(), 2, 'error: the memory does not suffice\n'),
    (ModuleNotFoundError("No module named 'rclpy'", name='rclpy'), 2, "'rclpy' is not installed"),
    (KeyboardInterrupt(), 130, ''),
])
def test_what_the_system_refuses_is_one_line(monkeypatch, capsys, error, code, told):
    def fail(_):
        raise error

    monkeypatch.setattr(command, '_run', fail)
    assert main(['run']) == code
    said = capsys.readouterr().err
    assert told in said and said.count('\n') == bool(told)


def test_a_module_of_ours_that_is_missing_is_a_fault_and_shows_where(monkeypatch):
    def fail(_):
        raise ModuleNotFoundError("No module named 'bags.x'", name='bags.x')

    monkeypatch.setattr(command, '_run', fail)
    with pytest.raises(ModuleNotFoundError):
        main(['run'])


def test_a_shipped_model_is_found_by_its_name():
    assert load_policy('racing').description.action_space.names


def test_a_folder_is_not_taken_for_a_name(tmp_path):
    shipped = share_path('models/racing')
    assert as_parameter(str(shipped), '.') == 'racing'
    for name in ('racing', 'random', '~here'):
        shutil.copytree(share_path('models/report'), tmp_path / name)
    # where a node finds a folder of that name first
    assert (tmp_path / as_parameter(str(shipped), '.')).samefile(shipped)
    for name in ('racing', 'random', '~here'):
        chosen = choose_model(f'./{name}')
        assert chosen != RANDOM and find_model(as_parameter(chosen, '.')).samefile(name)
        assert model_source(f'./{name}').model != RANDOM


HOSTILE = '[/x][red]\x1b]52;c;aGk=\x07:boom:'


def state_of(**values):
    state = GraphState()
    for kind in (SIMULATOR, POLICY, TRAINER):
        state.health[f'/{kind.name}'] = {'summary': HOSTILE, **values}
    return state


def shown(width, height, *, terminal, state, table, line):
    text = io.StringIO()
    console = Console(file=text, width=width, height=height, force_terminal=terminal,
                      color_system=None, legacy_windows=False)
    display = Display(state, table, line, console)
    with display:
        for _ in range(3):
            display.update()
    display.say(f'output {HOSTILE}')
    display.finish()
    return text.getvalue()


def test_what_others_say_is_shown_as_it_is_and_said_once(monkeypatch):
    monkeypatch.setattr('carracing_dqn.bringup.display.LINE_SECONDS', 0.0)
    for line, table in ((laps_line, laps_table), (training_line, training_table)):
        said = shown(80, 24, terminal=False, state=state_of(), table=table, line=line)
        assert said.count('[/x][red]') == 2 and '\x1b' not in said and ':boom:' in said


def test_tables_fit_into_a_small_terminal():
    state = state_of(wall_seconds='61', progress='0.5', weights_version='3', epsilon='1')
    state.health[f'/{POLICY.name}']['weights_version'] = '4'
    state.health[f'/{TRAINER.name}']['summary'] = 14 * 'ten chars '
    for number in range(40):
        state.ended += 1
        state.episodes.append({**dict.fromkeys(EPISODE_CORE, 1.0), 'seed': float(number)})
        state.validations.append(dict.fromkeys(VALIDATION_FIELDS, 1000.0))
        state.curve.add(float(number), float(number))
    for cars in (0, 40):
        state.cars = {f'/car_{number}': {'summary': 'learned from'} for number in range(cars)}
        for table in (laps_table, training_table):
            text = io.StringIO()
            Console(file=text, width=80, height=24).print(table(state, 24))
            lines = text.getvalue().splitlines()
            assert len(lines) < 24 and max(map(len, lines)) <= 80
            assert '…' not in text.getvalue()
        assert cars or re.search(r'weight age \(versions\) *│ *0 ', text.getvalue())
        assert ('▁' in text.getvalue()) == (not cars)


def test_a_curve_shows_the_whole_run_in_bounded_memory():
    curve = Curve()
    for second in range(20_000):
        curve.add(float(second), float(second))
    assert MOST_POINTS // 4 < len(curve.points) < MOST_POINTS
    assert curve.points[0][0] == 0.0 and curve.points[-1][0] > 19_900
    gaps = [later[0] - earlier[0] for earlier, later in zip(curve.points, curve.points[1:])]
    assert max(gaps) < 3 * 20_000 / MOST_POINTS
    line = spark([(20_000 - at, value) for at, value in curve.points], 24, 3)
    rows = line.split('\n')
    assert [len(row) for row in rows] == [24] * 3
    assert rows[0][:15].strip() == '' and rows[0][-1] == rows[2][-1] == '█' and rows[2][0] in '▁▂'
    # a run that is begun anew has a curve of its own
    curve.add(1.0, 5.0)
    assert curve.points == [(1.0, 5.0)]


@pytest.mark.parametrize('said', [
    (('1', '1e308'), ('2', '-1e308'), ('3', '1e308')), (('1e-320', '1'), ('2e-320', '2')),
    (('-1.7e308', '1'), ('1.7e308', '2'))])
def test_no_number_of_a_trainer_ends_the_display(said):
    state = GraphState()
    for seconds, mean in said:
        state.take_diagnostics(DiagnosticArray(status=[DiagnosticStatus(
            name=f'/{TRAINER.name}', values=[KeyValue(key='wall_seconds', value=seconds),
                                             KeyValue(key='mean_return', value=mean)])]))
    text = io.StringIO()
    Console(file=text, width=80, height=60).print(training_table(state, 60))
    assert '▁' in text.getvalue() and '█' in text.getvalue()


def test_a_resumed_run_goes_on_with_its_curve(tmp_path):
    episodes = tmp_path / 'episodes.csv'
    assert past_returns(episodes, 9, 2) == []
    episodes.write_text('episode,train_reward,wall_seconds\n0,10,1\n1,20,2\n2,x,3\n3,40,4\n')
    # what came after the checkpoint is driven again
    assert past_returns(episodes, 3, 2) == [(1.0, 10.0), (2.0, 15.0)]
    assert past_returns(episodes, 9, 2)[-1] == (4.0, 30.0)


def test_what_a_trainer_lacks_stands_in_the_line():
    state = state_of(wall_seconds='60', episodes='0', decisions='7', epsilon_at_end='0.4')
    state.health[f'/{TRAINER.name}']['summary'] = 'no step: nobody publishes /step'
    assert training_line(state).endswith('; no step: nobody publishes /step')
    # a log has the whole sentence from the trainer, once
    state.health[f'/{TRAINER.name}']['summary'] = f'{TOO_SLOW}: at 3 decisions/s and so on'
    assert training_line(state).endswith(f'; {TOO_SLOW}, epsilon at the end about 0.40')
    state.health[f'/{TRAINER.name}']['summary'] = 'learning'
    assert ';' not in training_line(state)


def test_a_line_before_the_first_episode_claims_no_return():
    line = training_line(state_of(wall_seconds='60', episodes='0', decisions='7'))
    assert line.startswith('1.0 min, no episode yet, 7 decisions') and 'return' not in line
