# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Studies: what their files may say, runs in processes of their own, and the page."""
import csv
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

from carracing_dqn.bringup import command
from carracing_dqn.bringup.command import main
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.studies.bootstrap import (
    estimate, improvement, interquartile_mean, permutation_p,
)
from carracing_dqn.studies.curves import draw
from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.one_process import learn
from carracing_dqn.evaluation.results import Results, write_json
from carracing_dqn.studies.outcome import Curve, DONE, Outcome, outcome_of, UNFINISHED
from carracing_dqn.studies.page import write_page
from carracing_dqn.studies.schedule import why_ended
from carracing_dqn.studies.search import Search
from carracing_dqn.studies.study_file import (
    find_study, load_study, plan, StudySettings, study_names,
)
from dqn_policy_node.model_folder import load_model, Model, save_model
from dqn_policy_node.model_record import read_model_record
from dqn_policy_node.network import QNetwork
import numpy as np
import pytest
import torch
from trainer_node.hyperparameters import load_preset, to_yaml
from trainer_node.training import Training
import yaml

PRESET = {
    'convolutions': '4@6/3', 'hidden': 8, 'shrink': 2, 'replay_capacity': 2000,
    'learning_starts': 50, 'batch_size': 8, 'samples_per_transition': 2.0, 'run_episodes': 0,
    'validation_every_episodes': 0, 'epsilon_schedule': 'decisions', 'epsilon_decisions': 500,
    'checkpoint_every_minutes': 0.02, 'action_space': 'steer5'}
STUDY = {
    'about': 'Which is better?', 'preset': 'tiny.yaml', 'simulator': 'toy_simulator:Toy',
    'set': {'run_decisions': 400}, 'seeds': [5, 6, 5], 'laps': 3}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, 'stop_on_signals', lambda: None)
    shutil.copy(Path(__file__).with_name('toy_simulator.py'), tmp_path)
    Path('tiny.yaml').write_text(yaml.safe_dump(PRESET))
    return tmp_path


def write(name='which', **changes):
    Path(f'{name}.yaml').write_text(yaml.safe_dump({**STUDY, **changes}, sort_keys=False))
    return f'{name}.yaml'


def test_what_fails_is_named_and_the_rest_goes_on(folder, capsys):
    path = write(arms={
        'plain': {'about': 'as it is'},
        'double': {'set': {'double': True}, 'seeds': [5]},
        'unknown': {'preset': 'nothing', 'seeds': [1]},
        'again': {'seeds': [5]},
        'speed': {'set': {'speed_weight': 1.0}, 'seeds': [1]},
        'endless': {'set': {'run_decisions': 0}, 'seeds': [1]}})
    assert main(['study', path, '--processes', '2']) == 1
    said = capsys.readouterr().out
    for text in ('seed 5 is named more than once and is run once', "no preset 'nothing'",
                 'the same settings and seed as plain, seed 5', "needs 'speed'",
                 'endless, seed 1: FAILED: a run of a study is as long on every machine'):
        assert text in said, said
    page = Path('runs/studies/which/which.md').read_text()
    assert 'Which is better?' in page and '3 of 7 runs are done' in page
    assert "needs 'speed'" in page and 'runs/studies/which/plain/seed-5' in page
    done = next(line for line in page.splitlines() if line.startswith('| plain, seed 5 |'))
    assert re.match(r'\| plain, seed 5 \| done \| [-.0-9]+ \| 400 \| \d+ \| \d+ \| ', done), done
    assert str(folder) not in page and '| **' not in page.split('## Arms')[1]
    assert Path('runs/studies/which/which.png').read_bytes()[:4] == b'\x89PNG'
    record = json.loads(Path('runs/studies/which/which.json').read_text())
    assert len(record['arms']['plain']['runs'][0]['scores']) == 3
    assert str(folder) not in json.dumps(record)
    # what is done is not done again; what failed is tried again
    before = Path('runs/studies/which/plain/seed-5/run.json').stat().st_mtime_ns
    assert main(['study', path, '--processes', '2', '--only', 'plain']) == 1
    assert 'plain, seed 5: done before' in capsys.readouterr().out
    assert Path('runs/studies/which/plain/seed-5/run.json').stat().st_mtime_ns == before
    # two beside each other learned what one learns alone
    alone = Training.create(load_preset('runs/studies/which/plain/seed-6/plan.yaml'),
                            folder / 'alone', device='cpu')
    learn(alone)
    mine, theirs = (load_model(path).tensors for path in (
        folder / 'alone' / 'final', 'runs/studies/which/plain/seed-6/final'))
    assert all(torch.equal(tensor, theirs[name]) for name, tensor in mine.items())
    # a study that has changed does not take the old runs for its own
    assert main(['study', write(
        arms={'plain': {}}, set={'run_decisions': 300})]) == 1
    assert 'other settings than the study asks for' in capsys.readouterr().out


def test_a_study_that_is_stopped_goes_on_where_it_was(folder):
    path = write(set={'run_decisions': 2500}, seeds=[1], laps=0)
    words = [sys.executable, '-m', 'carracing_dqn.bringup', 'study', path]
    rows = Path('runs/studies/which/preset/seed-1/episodes.csv')

    def episodes():
        with rows.open(newline='') as file:
            return [row['decisions'] for row in csv.DictReader(file)]

    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    until = time.monotonic() + 120
    while not (rows.is_file() and len(episodes()) > 3) and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert 'stopped; go on with: carracing study which.yaml' in said
    assert '0 of 1 runs are done' in Path('runs/studies/which/which.md').read_text()
    before = episodes()
    assert len(before) > 3 and int(before[-1]) < 2500
    assert main(['study', path]) == 0
    assert episodes()[:len(before)] == before
    record = json.loads(rows.with_name('run.json').read_text())
    assert len(record['sessions']) == 2 and record['complete']
    assert load_model(rows.parent / 'final').training['decisions'] == 2500


def driven(study, output, **training):
    """Write the folder of a run that is complete, with laps of its last weights; return both."""
    run, = plan(study, study.arms, output)
    description = run.settings.model_description()
    run.folder.mkdir(parents=True)
    (run.folder / 'plan.yaml').write_text(to_yaml(run.settings))
    (run.folder / 'run.json').write_text(json.dumps({'complete': True, 'wall_seconds': 120}))
    (run.folder / 'episodes.csv').write_text(
        'episode,decisions,train_reward\n0,100,1.0\n1,200,3.0\n')
    for name in ('best', 'final'):
        save_model(run.folder / name, Model(
            description, dict(QNetwork(description).state_dict()), training, 1))
    laps = {seed: Lap(seed, 5.0, 9) for seed in range(200_000, 200_003)}
    weights = read_model_record(run.folder / 'final').weights_sha256
    write_json(run.folder / 'evaluation.json', Results(
        {'kind': 'model', 'weights_sha256': weights}, 'toy_simulator:Toy', laps, 3))
    return run


def test_laps_of_other_weights_than_the_study_asks_for_are_not_its(folder):
    run = driven(load_study(Path(write(seeds=[5]))), folder / 'out')
    assert outcome_of(run, StudySettings(laps=3)).state == DONE
    for changes in ({'model': 'best'}, {'laps': 4}, {'test_seed': 200_001}):
        outcome = outcome_of(run, StudySettings(**{'laps': 3, **changes}))
        assert outcome.state == UNFINISHED and not outcome.laps, changes


@pytest.mark.parametrize('training', [
    {'decisions': 10**400, 'episodes': 2, 'updates': float('nan')}, {'decisions': 'many'},
    {'decisions': [], 'episodes': True, 'updates': float('inf')}])
def test_whatever_a_model_says_of_its_training_its_run_is_shown(folder, training):
    study = load_study(Path(write(seeds=[5], about='\ud800', set={'run_decisions': 400})))
    run = driven(study, folder / 'out', **training)
    (run.folder / 'run.json').write_text('{"complete": true, "wall_seconds": NaN}')
    outcome = outcome_of(run, StudySettings(laps=3))
    assert outcome.figures == {'episodes': 2.0, 'decisions': 200.0, 'minutes': 0.0} | (
        {'episodes': 2.0} if training.get('episodes') == 2 else {})
    write_page(study, study.arms, [outcome], folder / 'page')
    json.loads((folder / 'page' / 'which.json').read_text(), parse_constant=pytest.fail)


def test_a_run_without_a_return_is_not_done(folder):
    run = driven(load_study(Path(write(seeds=[5]))), folder / 'out')
    assert outcome_of(run, StudySettings(laps=0)).scores == 2.0
    (run.folder / 'episodes.csv').write_text('episode,decisions,train_reward\n0,100,\n')
    outcome = outcome_of(run, StudySettings(laps=0))
    assert outcome.state != DONE and 'no episode ended' in outcome.problem


def test_words_of_a_study_stay_in_their_cells(folder):
    path = write(arms={'plain': {'about': 'one | two\nthree'}})
    assert main(['study', path, '--no-runs']) == 0
    row, = [line for line in Path('runs/studies/which/which.md').read_text().splitlines()
            if line.startswith('| plain | one')]
    assert row == '| plain | one / two three |  |'


def test_how_to_go_on_names_the_folder(folder, monkeypatch, capsys):
    monkeypatch.setattr('carracing_dqn.studies.command._Session._drive_runs', lambda _: True)
    assert main(['study', write(laps=0), '--output', 'a b']) == 130
    assert "carracing study which.yaml --output='a b'" in capsys.readouterr().out


def test_why_a_process_ended_is_told(folder):
    assert why_ended(folder, -9) == 'its process was ended by signal 9'
    assert why_ended(folder, 3) == 'its process ended with code 3'
    (folder / 'log.txt').write_text('Traceback\n  x\n\nerror: the disk\x1b is full\n')
    assert why_ended(folder, 2) == 'the disk? is full'
    assert why_ended(folder, 130) == 'stopped by a signal'
    (folder / 'log.txt').unlink()
    os.mkfifo(folder / 'log.txt')
    assert why_ended(folder, 2) == 'its process ended with code 2'


def test_a_run_ends_with_what_started_it(folder):
    path = write(set={'run_decisions': 10**6}, seeds=[1], laps=0)
    run = Path('runs/studies/which/preset/seed-1')
    process = subprocess.Popen([sys.executable, '-m', 'carracing_dqn.bringup', 'study', path])
    until = time.monotonic() + 120
    while not (run / 'checkpoint' / 'checkpoint.safetensors').is_file() and (
            time.monotonic() < until):
        time.sleep(0.05)
    process.kill()
    process.wait()
    # who learns into a run folder holds its lock
    from trainer_node.errors import RunError
    from trainer_node.run_folder import RunFolder
    while time.monotonic() < until:
        try:
            RunFolder(run).lock()
            break
        except RunError:
            time.sleep(0.1)
    else:
        pytest.fail('the run goes on without the study')
    RunFolder(run).unlock()


@pytest.mark.parametrize(('changes', 'told'), [
    ({'arm': {}}, "unknown setting 'arm'"),
    ({'laps': -1}, 'laps is -1'),
    ({'seeds': []}, 'seeds must be a list'),
    ({'seeds': [-1]}, 'seed is -1'),
    ({'seeds': ['a']}, 'seed must be a whole number'),
    ({'arms': {'../x': {}}}, 'a folder is called so'),
    ({'arms': {'x': {'sets': {}}}}, "unknown setting 'sets'"),
    ({'arms': {'x': {'set': 3}}}, "arm 'x': set must be a mapping"),
    ({'arms': {'x': 3}}, "arm 'x' must be a mapping"),
    ({'arms': {'x': {}}, 'baseline': 'y'}, "baseline is 'y', which is no arm"),
    ({'grid': {'gamma': 0.9}}, 'grid: gamma must be a list'),
    ({'grid': {'gamma': list(range(1000))}}, 'more than 1000 runs'),
    ({'grid': {'loss': ['../../x']}}, 'cannot be the name of a folder'),
    ({'arms': {'loss=l1': {}}, 'grid': {'loss': ['l1']}}, 'two arms are called'),
    ({'model': 'first'}, 'model is'),
])
def test_a_file_that_is_none_is_one_line(folder, changes, told, capsys):
    assert main(['study', write(**changes)]) == 2
    said = capsys.readouterr()
    assert told in said.err and said.err.count('\n') == 1
    assert not Path('runs').exists()


def test_words_that_are_none_are_one_line(folder, capsys):
    Path('list.yaml').write_text('- 1\n')
    path = write()
    for words, told in (
            (['nowhere'], "no study 'nowhere'"), (['list.yaml'], 'must be a mapping'),
            ([path, '--processes', '0'], '--processes is 0'),
            ([path, '--only', 'x'], '--only x: there is no such arm')):
        assert main(['study', *words]) == 2
        said = capsys.readouterr()
        assert told in said.err and said.err.count('\n') == 1
    assert not Path('runs').exists()


def test_a_grid_is_an_arm_for_every_combination(folder):
    study = load_study(Path(write(grid={'gamma': [0.9, 0.99], 'double': [True, False]})))
    assert [arm.name for arm in study.arms] == [
        'gamma=0.9+double=true', 'gamma=0.9+double=false', 'gamma=0.99+double=true',
        'gamma=0.99+double=false']
    runs = plan(study, study.arms, folder / 'out')
    # every arm has a run before any has two
    assert [run.seed for run in runs] == [5] * 4 + [6] * 4
    assert runs[0].settings.gamma == 0.9 and runs[0].settings.double
    assert runs[0].settings.frame_height == 32 and not any(run.problem for run in runs)


def test_what_goes_by_minutes_goes_by_decisions(folder):
    study = load_study(Path(write(preset='racing', simulator='', set={
        'run_decisions': 80_000, 'run_minutes': 40.0, 'validation_every_minutes': 5.0})))
    settings = plan(study, study.arms, folder)[0].settings
    assert settings.run_minutes == settings.validation_every_minutes == 0
    assert (settings.run_decisions, settings.validation_every_decisions) == (80_000, 10_000)


@pytest.mark.parametrize('name', study_names())
def test_the_studies_of_the_package_can_be_run(name, tmp_path):
    study = load_study(find_study(name))
    runs = plan(study, study.arms, tmp_path)
    assert not study.notes and [run.problem for run in runs if run.problem] == []
    assert study.settings.about and (runs or study.search)
    assert all(arm.about for arm in study.arms)


SPACE = {'learning_rate': {'low': 1e-5, 'high': 1e-2, 'log': True},
         'batch_size': {'low': 8, 'high': 16}, 'loss': ['l1', 'huber']}


def search_of(**changes):
    return load_study(Path(write(search={'trials': 30, 'space': SPACE, **changes}, seeds=[1])))


def test_a_search_draws_from_its_space_and_goes_on_with_the_same(folder):
    search = Search(search_of(), folder)
    arms = [search.draw({}) for _ in range(30)]
    assert search.complete
    drawn = [dict(arm.set) for arm in arms]
    assert {values['loss'] for values in drawn} == {'l1', 'huber'}
    assert {type(values['batch_size']) for values in drawn} == {int}
    assert {values['batch_size'] for values in drawn} <= set(range(8, 17))
    assert len({tuple(values.values()) for values in drawn}) == len(drawn) == len(plan(
        search_of(), tuple(arms), folder))
    rates = [values['learning_rate'] for values in drawn]
    assert min(rates) < 1e-4 < 1e-3 < max(rates)
    again = Search(search_of(), folder)
    assert [dict(arm.set) for arm in again.arms] == drawn
    other = folder / 'other'
    other.mkdir()
    fresh = Search(search_of(), other)
    assert dict(fresh.draw({}).set) == drawn[0]
    small = Search(search_of(space={'double': [True, False]}), folder / 'small')
    (folder / 'small').mkdir()
    assert [small.draw({}) is None for _ in range(4)] == [False, False, True, True]
    for trials in ('[{}]', '{}', '""', 'null', '[[]]'):
        (folder / 'search.json').write_text(
            f'{{"format": "carracing_dqn search 1", "trials": {trials}}}')
        with pytest.raises(StudyError, match='trials of another search'):
            Search(search_of(), folder)


def test_optuna_chooses_by_what_earlier_trials_earned(folder):
    pytest.importorskip('optuna', reason='the extra search is not installed')
    search = Search(search_of(sampler='tpe', trials=40), folder)
    scores = {}
    while not search.complete:
        arm = search.draw(scores)
        scores[arm.name] = -abs(np.log(arm.set['learning_rate'] / 1e-3)) - (
            arm.set['loss'] == 'l1')
    late = [arm.set for arm in search.arms[25:]]
    assert np.mean([values['loss'] == 'huber' for values in late]) > 0.6
    assert np.median([abs(np.log(v['learning_rate'] / 1e-3)) for v in late]) < 1.5


@pytest.mark.parametrize(('changes', 'told'), [
    ({'space': {}}, 'space must be a mapping'),
    ({'space': {'rate': [1]}}, "unknown setting 'rate'"),
    ({'space': {'gamma': [2.0]}}, 'gamma is 2.0'),
    ({'space': {'gamma': {'low': 0.9}}}, 'gamma must be a list of values, or low, high'),
    ({'space': {'loss': {'low': 0, 'high': 1}}}, 'loss must be a list of values'),
    ({'space': {'gamma': {'low': 0.9, 'high': 0.8}}}, 'low must be below high'),
    ({'space': {'gamma': {'low': 0.0, 'high': 0.8, 'log': True}}}, 'low must be below high'),
    ({'trials': 0}, 'trials is 0'), ({'trails': 3}, "unknown setting 'trails'"),
    ({'sampler': 'grid'}, 'sampler is'),
])
def test_a_search_that_is_none_is_one_line(folder, changes, told):
    with pytest.raises(StudyError, match='search: ') as caught:
        Search(search_of(**changes), folder)
    assert told in str(caught.value)


def test_a_search_is_driven_and_compared(folder, capsys):
    path = write(search={'trials': 2, 'space': {'gamma': [0.9, 0.99], 'double': [True, False]}},
                 seeds=[1], laps=0, set={'run_decisions': 150})
    assert main(['study', path, '--processes', '2']) == 0
    page = Path('runs/studies/which/which.md').read_text()
    assert '2 of 2 runs are done' in page and 'P(better than trial-000)' in page
    assert main(['study', path]) == 0
    assert capsys.readouterr().out.count('done before') == 2


@pytest.mark.parametrize('state, panels', [(UNFINISHED, 1), (DONE, 2)])
def test_a_figure_has_no_empty_half(state, panels):
    curve = Curve(np.arange(3.0), np.arange(3.0))
    outcome = Outcome(None, state, '', curve, {1: Lap(1, 5.0, 9)}, curve.returns, {})
    assert len(draw({'one': [outcome]}, 'episodes', 'return').axes) == panels


def test_interquartile_mean_by_hand():
    assert interquartile_mean(np.array([[1.0, 100.0], [2.0, 3.0]])) == 2.5
    assert interquartile_mean(np.arange(8.0).reshape(2, 4)) == 3.5
    assert interquartile_mean(np.array([[4.0]])) == 4.0


def test_probability_of_improvement_by_hand():
    # two runs against one on two tracks: 1 of 2 better on the first, both worse, one equal
    found = improvement(np.array([[1.0, 1.0], [3.0, 2.0]]), np.array([[2.0, 2.0]]))
    assert found.value == pytest.approx((1 + 0.5) / 4) and found.low is None
    same = np.random.default_rng(0).normal(size=(8, 30))
    other = np.random.default_rng(1).normal(size=(8, 30))
    near, far = improvement(same, other), improvement(same + 9, other)
    assert near.low < 0.5 < near.high and far.low == far.value == 1.0


def test_intervals_are_over_whole_runs():
    # each run the same on all its tracks: a hundred laps say no more than one
    runs = np.array([0.0, 1.0, 5.0])
    few, many = (estimate(np.repeat(runs[:, None], count, axis=1), np.mean)
                 for count in (1, 100))
    assert (few.low, few.high) == pytest.approx((many.low, many.high))
    assert few.low == 0.0 and few.high == 5.0
    assert estimate(np.ones((1, 5)), np.mean).low is None


def test_the_permutation_test_counts_every_way():
    three, others = np.array([[1.0], [2.0], [3.0]]), np.array([[7.0], [8.0], [9.0]])
    assert permutation_p(three, others) == pytest.approx(2 / 20)
    assert permutation_p(three, three) == 1.0
    many = np.arange(12.0)[:, None]
    assert permutation_p(many, many + 30) < 0.001
    # rounding of large returns makes no way rarer than it is
    random = np.random.default_rng(0)
    for scale in (1.0, 1e6, 1e12):
        for _ in range(20):
            some, more = random.normal(size=(2, 3, 4))
            assert permutation_p(scale * some, scale * (more + 20)) == pytest.approx(2 / 20)


def test_no_page_names_this_machine():
    page = Path(__file__).resolve().parents[1] / 'docs' / 'studies'
    for path in page.glob('*.*'):
        if path.suffix in ('.md', '.json'):
            assert os.path.expanduser('~') + '/' not in path.read_text(), path
