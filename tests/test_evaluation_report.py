# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The report: every file, every figure, and pages of runs that are not whole."""
import base64
import contextlib
import json
from pathlib import Path
import re
from xml.etree import ElementTree

from carracing_dqn.bringup.command import main as carracing
from carracing_dqn.evaluation.figures import draw, FIGURES, NothingToShow
from carracing_dqn.evaluation.records import load_run, Run
from carracing_dqn.evaluation.report_command import _compare_with_record
from carracing_dqn.evaluation.report_page import (
    headlines, make_pictures, markdown, Picture, render,
)
from carracing_dqn.evaluation.results import read_json
from evaluation_cases import lap, write_run
from msgs_bridge.share import share_path
import numpy as np
import pytest

CURVE = np.linspace(-50, 900, 60).round(1).tolist()
VALIDATIONS = [(10, 100, 50), (40, 700, 40), (59, 850, 30)]


def whole_run(folder):
    return write_run(folder, CURVE, validations=VALIDATIONS, test=[800, 910, 930], dummy=[-60])


@pytest.fixture
def no_figures(monkeypatch):
    """Leave out what takes most of the time."""
    monkeypatch.setattr('carracing_dqn.evaluation.report_page.FIGURES', ())


def drawn(run):
    """Return the names of the figures that can be drawn of a run."""
    names = []
    for kind in FIGURES:
        with contextlib.suppress(NothingToShow):
            draw(kind, [run])
            names.append(kind.name)
    return names


def page_of(*runs, pictures=()):
    return render(runs, pictures, [])


def test_the_command_writes_everything(tmp_path, capsys):
    run = whole_run(tmp_path / 'run')
    other = write_run(tmp_path / 'other', CURVE[:7], validations=())
    assert carracing(['report', str(run), '--against', str(other), '--against', 'seed',
                      '--output', str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    assert 'other: validation.csv has no row yet.' in said
    assert 'run: pass: Show improvement' in said
    out = tmp_path / 'out'
    assert {path.name for path in out.iterdir()} == {
        'figures', 'report.html', 'tables.json', 'tables.md'}
    names = {path.name for path in (out / 'figures').iterdir()}
    assert names == {f'{kind.name}.{suffix}' for kind in FIGURES for suffix in ('png', 'svg')}
    for path in (out / 'figures').glob('*.svg'):
        ElementTree.parse(path)
    for path in (out / 'figures').glob('*.png'):
        assert path.read_bytes().startswith(b'\x89PNG')
    tables = json.loads((out / 'tables.json').read_text())
    assert tables['run']['figures']['test_mean']['value'] == 880
    assert tables['run']['figures']['test_mean']['stated_value'] == 855.74
    assert '| mean | 3.2.3 | 855.74 | 880.00 | – (no laps' in (out / 'tables.md').read_text()


def test_the_page_carries_everything_inside_and_is_always_the_same(tmp_path):
    folder = whole_run(tmp_path / 'run')
    page, again = (page_of(run, pictures=make_pictures([run]))
                   for run in (load_run(folder), load_run(folder)))
    assert page == again
    sources = re.findall(r'(?:src|srcset|href)="([^"]*)"', page)
    assert len(sources) == 2 * len(FIGURES)
    for source in sources:
        kind, data = source.split(',', 1)
        assert kind == 'data:image/svg+xml;base64'
        ElementTree.fromstring(base64.b64decode(data))
    assert '<script' not in page and 'http' not in re.sub(r'base64,[^"]*', '', page)
    assert '855.74' in page and '880.00' in page


def test_names_cannot_break_the_page(tmp_path):
    run = load_run(whole_run(tmp_path / 'run'))
    run.name = '<b>|bold'
    run.problems.append('<script>')
    page = page_of(run)
    assert '<b>|bold' not in page and '<script>' not in page
    assert '<b>\\|bold' in markdown([run], [[]])


@pytest.mark.parametrize('keep', ['episodes', 'validation', 'updates', 'evaluation'])
def test_one_file_is_enough(tmp_path, keep):
    folder = whole_run(tmp_path / 'run')
    for path in folder.iterdir():
        if path.stem != keep:
            path.unlink()
    run = load_run(folder)
    assert 0 < len(drawn(run)) < len(FIGURES)
    missing = [Picture(kind.name, kind.title, kind.caption, reason='why') for kind in FIGURES]
    assert page_of(run, pictures=missing).count('Nothing to show: why') == len(FIGURES)


@pytest.mark.parametrize('missing', ['episode', 'train_reward', 'wall_seconds', 'epsilon', 'loss'])
def test_a_missing_column_leaves_the_others(tmp_path, missing):
    folder = whole_run(tmp_path / 'run')
    path = folder / 'episodes.csv'
    header, rest = path.read_text().split('\n', 1)
    path.write_text(header.replace(missing, 'renamed') + '\n' + rest)
    run = load_run(folder)
    assert any(missing in problem for problem in run.problems)
    assert len(drawn(run)) >= len(FIGURES) - 1
    assert f'has no column {missing}' in page_of(run)


def test_a_page_without_test_laps_says_so_once_and_how_good_training_was(tmp_path):
    run = load_run(write_run(tmp_path / 'run', CURVE, validations=()))
    table = page_of(run).split('beside ours')[1]
    assert table.count('no laps of the trained agent') == 1
    assert table.count('>–</td>') > 10
    assert headlines(run)[0][1] == 'training, moving average at the end'
    run = load_run(write_run(tmp_path / 'other', CURVE, validations=VALIDATIONS))
    assert headlines(run)[0][:2] == ('850.00', 'best validation')


def test_a_run_without_anything_has_nothing_to_show(tmp_path):
    for kind in FIGURES:
        with pytest.raises(NothingToShow, match='no run has'):
            draw(kind, [Run('empty', tmp_path)])


def test_the_dummy_agent_is_driven_when_nobody_has(
    tmp_path, monkeypatch, capsys, no_figures,
):
    monkeypatch.setattr('carracing_dqn.evaluation.report_command.DUMMY_LAPS', 2)
    run = write_run(tmp_path / 'run', CURVE)
    assert carracing(['report', str(run), '--laps', '0']) == 0
    assert 'driving 2 now' in capsys.readouterr().out
    tables = json.loads((run / 'report' / 'tables.json').read_text())
    assert -100 < tables['run']['figures']['dummy_mean']['value'] < 0
    assert carracing(['report', str(run), '--laps', '0']) == 0
    assert 'driving' not in capsys.readouterr().out


def test_laps_of_the_dummy_agent_that_were_driven_before_ctrl_c_are_kept(
    tmp_path, monkeypatch, capsys, no_figures,
):
    monkeypatch.setattr('carracing_dqn.evaluation.report_command.DUMMY_LAPS', 3)

    def stopped(source, seeds, **_):
        yield lap(next(iter(seeds)), -30.0)
        raise KeyboardInterrupt

    run = write_run(tmp_path / 'run', CURVE)
    with monkeypatch.context() as patch:
        patch.setattr('carracing_dqn.evaluation.report_command.drive_laps', stopped)
        for kept in (1, 2):
            assert carracing(['report', str(run), '--laps', '0']) == 130
            assert f'stopped; {kept} laps are in' in capsys.readouterr().out
    assert carracing(['report', str(run), '--laps', '0']) == 0
    assert 'driving 1 now' in capsys.readouterr().out
    assert len(read_json(run / 'report' / 'dummy.json').laps) == 3


def test_a_report_of_a_model_leaves_its_folder_alone(tmp_path, monkeypatch, no_figures):
    monkeypatch.chdir(tmp_path)
    model = share_path(Path('models') / 'racing')
    before = sorted(model.rglob('*'))
    assert carracing(['report', str(model), '--laps', '0']) == 0
    assert (tmp_path / 'runs' / 'report-racing' / 'report.html').is_file()
    assert sorted(model.rglob('*')) == before


def test_runs_of_one_name_are_told_apart(tmp_path, no_figures):
    first, second = whole_run(tmp_path / 'a' / 'run'), whole_run(tmp_path / 'b' / 'run')
    assert carracing(['report', str(first), '--against', str(second),
                      '--output', str(tmp_path / 'out')]) == 0
    assert list(json.loads((tmp_path / 'out' / 'tables.json').read_text())) == [
        'run (a)', 'run (b)']


@pytest.mark.parametrize('name', ['a$\\frac$b', '_hidden', '$', 'n\udcff', 'ρ-赛车'])
def test_any_name_of_a_folder_stands_in_its_report(tmp_path, recwarn, monkeypatch, name):
    monkeypatch.setattr('carracing_dqn.evaluation.report_page.FIGURES', FIGURES[1:2])
    run = write_run(tmp_path / name, CURVE, dummy=[-60])
    assert carracing(['report', str(run), '--output', str(tmp_path / 'out')]) == 0
    shown = name.replace('\udcff', '?')
    assert f'<h1>{shown}</h1>' in (tmp_path / 'out/report.html').read_text()
    assert not [one for one in recwarn if 'Glyph' in str(one.message)]


@pytest.mark.parametrize('name', ['_hidden', 'a$\\frac$b'])
def test_a_run_of_any_name_stands_in_the_legend(tmp_path, name):
    run = load_run(write_run(tmp_path / name, CURVE, validations=VALIDATIONS))
    legend, = draw(FIGURES[1], [run]).legends
    assert legend.get_texts()[0].get_text().strip() == name.replace('$', r'\$')


@pytest.mark.parametrize('returns', [[2.0**53, -(2.0**53)], [2.0**53], [1e10, 1e10]])
def test_returns_of_any_size_are_drawn_in_few_bars(tmp_path, returns):
    kind, = [one for one in FIGURES if one.name == 'figure_4_reward_distribution']
    axes, = draw(kind, [load_run(write_run(tmp_path / 'run', [1], test=returns))]).axes
    assert 1 <= len(axes.patches) < 200


def test_halves_of_signs_in_records_do_no_harm(tmp_path, no_figures):
    run = whole_run(tmp_path / 'run')
    (run / 'run.json').write_text(r'{"started": "\ud800", "complete": true}')
    assert carracing(['report', str(run)]) == 0
    assert 'started' in (run / 'report/report.html').read_text()


@pytest.mark.parametrize(('words', 'message'), [
    (['/no/such/run'], 'no such run folder'),
    (['{run}', '--against', '/no/such/run'], 'no such run folder'),
    (['{run}', '--evaluation', '/no/such.json'], 'no such file'),
    (['{run}', '--evaluation', '{run}/dummy.json'], 'laps of a model are wanted'),
    (['{run}', '--dummy', '{run}/evaluation.json'], 'laps of random are wanted'),
    (['{run}', '--laps', '1000000000000'], '--laps is 1000000000000; accepted: 0 to 1000'),
    (['{run}', '--laps', '-1'], '--laps is -1'),
    (['{run}', '--output', '/proc/nowhere'], 'cannot be made'),
])
def test_bad_options_are_one_line_and_code_2(tmp_path, capsys, words, message):
    run = whole_run(tmp_path / 'run')
    assert carracing(['report', *(word.format(run=run) for word in words)]) == 2
    error = capsys.readouterr().err
    assert error.startswith('error: ') and message in error and error.count('\n') == 1


def test_a_model_that_cannot_be_used_is_a_problem_and_no_end(tmp_path, capsys, no_figures):
    run = whole_run(tmp_path / 'run')
    (run / 'best').mkdir()
    (run / 'best' / 'model.json').write_text('{}')
    assert carracing(['report', str(run)]) == 0
    assert 'No laps are shown' in capsys.readouterr().out


def test_laps_of_another_model_than_the_evaluation_are_noticed(tmp_path):
    run = load_run(whole_run(tmp_path / 'run'))
    _compare_with_record(run, run.evaluation.laps[100_001])
    _compare_with_record(run, lap(1, 5))
    assert run.problems == []
    _compare_with_record(run, lap(100_001, 500))
    assert 'Track 100001 was 910.0 points in the evaluation and is 500.0 now' in run.problems[0]
