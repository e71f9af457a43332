# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Runs that are being written, cut off, empty or odd: what is there is shown, the rest named."""
import json
import os
import shutil
import tracemalloc

from carracing_dqn.evaluation import tables
from carracing_dqn.evaluation.comparison import compare
from carracing_dqn.evaluation.errors import RecordsError, ResultsError
from carracing_dqn.evaluation.records import add_results, load_run
from carracing_dqn.evaluation.results import write_json
from carracing_dqn.evaluation.tables import read_table
from evaluation_cases import EPISODES, results, write_run
from dqn_policy_node import find_model
from dqn_policy_node.model_record import read_model_record
from msgs_bridge.yaml_text import dump_yaml
import numpy as np
import pytest


def test_a_whole_run_has_no_problems(tmp_path):
    run = load_run(write_run(
        tmp_path / 'run', [1, 2, 3], validations=[(1, 500, 20)], test=[900], dummy=[-50]))
    assert run.problems == []
    assert run.episodes.columns['train_reward'].tolist() == [1, 2, 3]
    assert run.validation.columns['mean'].tolist() == [500]
    assert run.evaluation.statistics.mean == 900 and run.dummy.statistics.mean == -50
    assert run.config['gamma'] == 0.97
    assert run.wall_seconds == 1800
    assert run.model is None


def test_columns_of_empty_cells_hold_nothing(tmp_path):
    run = load_run(write_run(tmp_path / 'run', [1, 2, 3]))
    assert run.episodes.has('train_reward', 'epsilon')
    assert not run.episodes.has('validation_reward')
    assert not run.episodes.has('no such column')


def test_half_a_row_at_the_end_is_left_out(tmp_path):
    folder = write_run(tmp_path / 'run', [10, 20, 30])
    path = folder / 'episodes.csv'
    path.write_text(path.read_text()[:-12])
    run = load_run(folder)
    assert run.episodes.columns['train_reward'].tolist() == [10, 20]
    assert run.problems == ['episodes.csv ends in the middle of a row, which was left out.']


def test_a_run_that_goes_on_says_so(tmp_path):
    folder = write_run(tmp_path / 'run', range(1000))
    (folder / 'run.json').write_text('{"complete": false, "wall_seconds": 60}')
    run = load_run(folder)
    assert run.problems == ['The run is not complete: it is still going on, or was stopped.']
    # six seconds an episode, the last of them number 999
    assert run.wall_seconds == 5994


@pytest.mark.parametrize(('text', 'problem'), [
    ('', 'x.csv is empty.'),
    ('\n\n', 'x.csv is empty.'),
    ('a,b\n', 'x.csv has no row yet.'),
    ('a\n1\n', 'x.csv has no column b.'),
    ('a,b\n1,2\n3\n4,5,6\n', 'x.csv: 2 rows with another number of cells than the header left'),
    ('a,b\n1,two\n3,inf\n', 'x.csv: 2 rows in which b is no number.'),
    ('a,b\n1,2', 'x.csv ends in the middle of a row'),
    ('a,b\n1,1e308\n1,-1e308\n', 'x.csv: 2 rows in which b is no number.'),
])
def test_odd_tables_are_read_as_far_as_they_go(tmp_path, text, problem):
    (tmp_path / 'x.csv').write_text(text)
    table, problems = read_table(tmp_path / 'x.csv', ('a', 'b'))
    assert any(problem in sentence for sentence in problems)
    assert {len(column) for column in table.columns.values()} <= {table.rows}


def test_a_table_that_is_not_there_is_named(tmp_path):
    table, problems = read_table(tmp_path / 'x.csv', ('a',))
    assert table.rows == 0 and problems == ['x.csv is not there.']
    (tmp_path / 'x.csv').mkdir()
    assert 'not a regular file' in read_table(tmp_path / 'x.csv', ('a',))[1][0]


def test_bytes_that_are_no_text_do_no_harm(tmp_path):
    (tmp_path / 'x.csv').write_bytes(b'a,b\n1,2\n\xff\x00,3\n')
    table, problems = read_table(tmp_path / 'x.csv', ('a', 'b'))
    np.testing.assert_equal(table.columns['a'], [1, float('nan')])
    assert problems == ['x.csv: 1 row in which a is no number.']


def test_known_keeps_columns_beside_each_other(tmp_path):
    (tmp_path / 'x.csv').write_text('a,b\n1,\n2,20\n,30\n4,40\n')
    table, _ = read_table(tmp_path / 'x.csv', ('a', 'b'))
    assert [column.tolist() for column in table.known('a', 'b')] == [[2, 4], [20, 40]]


def test_a_folder_with_nothing_to_report_is_refused(tmp_path):
    with pytest.raises(RecordsError, match='no such run folder'):
        load_run(tmp_path / 'nowhere')
    with pytest.raises(RecordsError, match='nothing to report: episodes.csv is not there'):
        load_run(tmp_path)
    (tmp_path / 'episodes.csv').write_text(EPISODES + '\n')
    with pytest.raises(RecordsError, match='has no row yet'):
        load_run(tmp_path)


def test_test_laps_alone_can_be_reported(tmp_path):
    write_json(tmp_path / 'evaluation.json', results([900]))
    run = load_run(tmp_path)
    assert run.evaluation is not None and run.episodes.rows == 0
    assert 'episodes.csv is not there.' in run.problems


def test_damaged_extras_are_problems_and_no_end(tmp_path):
    folder = write_run(tmp_path / 'run', [1])
    (folder / 'config.yaml').write_text('a: [1')
    (folder / 'run.json').write_text('[]')
    (folder / 'evaluation.json').write_text('{}')
    run = load_run(folder)
    assert run.config == {} and run.record == {} and run.evaluation is None
    assert len(run.problems) == 3


def test_the_record_may_lie_below_a_model(tmp_path):
    folder = write_run(tmp_path / 'model' / 'training', [1, 2])
    (tmp_path / 'model' / 'model.json').write_text('{}')
    run = load_run(tmp_path / 'model')
    assert run.name == 'model' and run.path == folder and run.episodes.rows == 2
    assert run.model == tmp_path / 'model'


def test_laps_that_are_given_take_the_place_of_those_found(tmp_path):
    run = load_run(write_run(tmp_path / 'run', [1], test=[900]))
    part = results([800, 810])
    part.wanted = 10
    write_json(tmp_path / 'other.json', part)
    add_results(run, tmp_path / 'other.json')
    assert run.evaluation.statistics.mean == 805
    assert run.problems == ['other.json holds 2 of 10 laps.']
    with pytest.raises(ResultsError, match='no such file'):
        add_results(run, tmp_path / 'none.json')


@pytest.mark.parametrize('name', [
    'episodes.csv', 'validation.csv', 'updates.csv', 'config.yaml', 'run.json',
    'evaluation.json'])
def test_a_file_that_never_ends_is_a_problem_and_no_end(tmp_path, name):
    folder = write_run(tmp_path / 'run', [1, 2], test=[900])
    (folder / name).unlink()
    os.mkfifo(folder / name)
    assert any(name in problem for problem in load_run(folder).problems)


@pytest.mark.parametrize('config', [
    'a: &a [1, 1]\nb: [*a, *a]\n', 'gamma: 1\ngamma: 2\n', 'gamma: !!float x\n'])
def test_settings_that_would_unfold_or_are_no_yaml_are_a_problem(tmp_path, config):
    folder = write_run(tmp_path / 'run', [1])
    (folder / 'config.yaml').write_text(config)
    run = load_run(folder)
    assert run.config == {} and 'config.yaml cannot be used' in run.problems[0]


@pytest.mark.parametrize('value', ['often', [1], {'a': 1}, float('nan'), 10**70, None, True])
def test_no_setting_ends_the_comparison(tmp_path, value):
    folder = write_run(tmp_path / 'run', [1, 2])
    (folder / 'config.yaml').write_text(dump_yaml(dict.fromkeys((
        'gamma', 'epsilon_decay', 'epsilon_schedule', 'epsilon_decisions', 'target_every',
        'validation_every_minutes', 'patience_episodes', 'learning_rate_schedule'), value)
        | {'validation_every_episodes': 0}))
    assert all(len(measured.text) < 200 for _, measured in compare(load_run(folder)))


def test_a_time_of_any_size_is_none_or_bounded(tmp_path):
    folder = write_run(tmp_path / 'run', [1, 2])
    for value in (10**400, float('inf'), float('nan'), -1, 'long'):
        (folder / 'run.json').write_text(json.dumps({'wall_seconds': value}))
        assert 0 <= load_run(folder).wall_seconds <= 1e12


def test_laps_in_another_simulator_are_not_those_of_the_run(tmp_path):
    folder = write_run(tmp_path / 'run', [1], test=[900])
    elsewhere = results([300])
    elsewhere.simulator = 'racetrack'
    write_json(folder / 'evaluation-later.json', elsewhere)
    run = load_run(folder)
    assert run.evaluation.statistics.mean == 900
    assert 'holds laps in racetrack, and run learned in carracing' in run.problems[0]
    (folder / 'config.yaml').write_text('simulator: racetrack\n')
    assert load_run(folder).evaluation.statistics.mean == 300


@pytest.mark.parametrize(('learned', 'driven', 'same'), [
    ('robots.sim:Fast', 'robots.track:Slow', False), ('robots.sim:Fast', 'robots.sim:Fast', True),
    ('worlds/mine.yaml', '../worlds/mine.yaml', True), ('worlds/mine.yaml', 'mine', True),
    ('worlds/mine.yaml', 'worlds/other.yaml', False)])
def test_simulators_are_told_apart_by_their_names(tmp_path, learned, driven, same):
    folder = write_run(tmp_path / 'run', [1])
    (folder / 'config.yaml').write_text(f'simulator: {learned}\n')
    elsewhere = results([300])
    elsewhere.simulator = driven
    write_json(folder / 'evaluation.json', elsewhere)
    assert (load_run(folder).evaluation is not None) == same


def test_who_has_driven_is_said_where_it_was_not_the_model_as_it_is(tmp_path):
    folder = write_run(tmp_path / 'run', [1])
    shutil.copytree(find_model('racing'), folder / 'best')
    weights = read_model_record(folder / 'best').weights_sha256
    for policy, said in (
        ({'kind': 'model', 'weights_sha256': weights, 'action_repeat': 2}, None),
        ({'kind': 'model', 'weights_sha256': weights, 'action_repeat': 5},
         'actions were held for 5 frames; the model was trained with 2'),
        ({'kind': 'model', 'weights_sha256': 'x'}, 'of other weights than those in best'),
        ({'kind': 'custom', 'name': 'mine:Policy'}, 'of mine:Policy, not of the model'),
    ):
        driven = results([300])
        driven.policy = policy
        write_json(folder / 'evaluation.json', driven)
        run = load_run(folder)
        assert len(run.problems) == bool(said) and (said is None or said in run.problems[0])


def test_a_table_takes_about_the_memory_of_its_numbers(tmp_path, monkeypatch):
    # as many bytes are set aside for the file
    monkeypatch.setattr(tables, 'MAX_BYTES', 2**20)
    path = tmp_path / 'x.csv'
    path.write_text('a,b,c,d\n' + '1,2,3,4\n' * 100_000)
    tracemalloc.start()
    try:
        table, problems = read_table(path, ('a', 'b'))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert table.rows == 100_000 and problems == []
    assert most < 3 * 4 * 8 * table.rows
    path.write_text(','.join('x' * 2000) + '\n')
    assert read_table(path, ('x',))[1] == ['x.csv has 2000 columns; accepted: 1000.']


def test_which_laps_are_shown_is_said(tmp_path):
    folder = write_run(tmp_path / 'run', [1], test=[900])
    write_json(folder / 'evaluation_2.json', results([300]))
    assert load_run(folder).problems == [
        'There are several files of laps; evaluation_2.json is shown.']
