# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The table against the seed document, and the objectives, against numbers worked out by hand."""
from carracing_dqn.evaluation.comparison import compare, judge, smoothing_window
from carracing_dqn.evaluation.records import load_run
from carracing_dqn.evaluation.seed_document import FIGURES, OBJECTIVES
from evaluation_cases import write_run
import pytest

# twenty episodes: the window of the moving average is 2
REWARDS = [-54, -40, -10, 30, 100, 200, 300, 400, 500, 600,
           700, 790, 830, 840, 860, 946, 300, -5, 820, 850]
VALIDATIONS = [(100, 300, 50), (650, 700, 40), (720, 850, 30), (1300, 910, 20), (1900, 805, 60)]


@pytest.fixture
def run(tmp_path):
    return load_run(write_run(
        tmp_path / 'run', REWARDS, validations=VALIDATIONS,
        test=[600] * 10 + [750] * 10 + [850] * 30 + [930] * 50, dummy=[-90, -94]))


def values(run):
    return {figure.key: measured.value for figure, measured in compare(run)}


def test_training(run):
    assert smoothing_window(20) == 2 and smoothing_window(5) == 1 and smoothing_window(5000) == 100
    found = values(run)
    assert found['train_first'] == -54
    # means of two: -47, -25, 10 (episode 3)
    assert found['train_average_zero'] == 3
    # (790 + 830) / 2 = 810 at episode 12
    assert found['train_average_800'] == 12
    assert found['train_average_last'] == 835
    assert (found['train_maximum'], found['train_maximum_episode']) == (946, 15)
    assert found['train_dips'] == -5
    assert found['train_last'] == 850
    assert found['train_mean'] == pytest.approx(sum(REWARDS) / 20)
    assert found['episodes'] == 20
    assert found['hours'] == 0.5


def test_validation(run):
    found = values(run)
    assert found['validation_first'] == 300
    assert found['validation_700'] == 850
    assert found['validation_above_800'] == 720
    assert (found['validation_maximum'], found['validation_maximum_episode']) == (910, 1300)
    assert found['validation_last'] == 805
    assert found['validation_mean'] == 713


def test_test_laps(run):
    found = values(run)
    # (10 * 600 + 10 * 750 + 30 * 850 + 50 * 930) / 100
    assert found['test_mean'] == 855
    # squares: 10 * 255^2 + 10 * 105^2 + 30 * 5^2 + 50 * 75^2 = 1042500
    assert found['test_std'] == pytest.approx((1042500 / 100) ** 0.5)
    assert (found['test_minimum'], found['test_maximum']) == (600, 930)
    assert (found['test_700'], found['test_800'], found['test_900']) == (90, 80, 50)
    assert found['test_completed'] == 0 and found['test_episodes'] == 100
    assert found['test_frames'] == 1000 and found['test_stopped'] == 0
    assert (found['dummy_mean'], found['dummy_std']) == (-92, 2)
    # from -92 to 855 is 947, of 92
    assert found['test_increase'] == pytest.approx(100 * 947 / 92)


def test_settings(run):
    texts = {figure.key: measured.text for figure, measured in compare(run)}
    assert texts['config.gamma'] == '0.97'
    assert texts['config.target_every'] == '10 episodes'
    assert texts['config.batch_size'] == '– (not in the record)'
    run.config = {
        'epsilon_decay': 0.995, 'epsilon_schedule': 'decisions', 'epsilon_decisions': 1000,
        'patience_episodes': 200, 'learning_rate_schedule': 'linear',
        'validation_every_episodes': 0, 'validation_every_minutes': 5.0}
    texts = {figure.key: measured.text for figure, measured in compare(run)}
    assert texts['config.epsilon_decay'] == 'linear over 1000 decisions'
    assert texts['config.patience_episodes'] == 'linear learning rate instead'
    assert texts['config.validation_every_episodes'] == '5 minutes'


def test_objectives(run):
    verdicts = {verdict.objective.key: verdict for verdict in judge(run)}
    assert all(verdict.passed for verdict in verdicts.values())
    assert '90 of 100 laps reach 700' in verdicts['consecutive'].text
    assert '855.00 ± 102.10 over 100 laps' in verdicts['average'].text
    assert 'first 2 episodes -47.00, of the last 2 835.00' in verdicts['improvement'].text
    assert '855.00 against -92.00: +1029 %' in verdicts['baseline'].text


def test_objectives_that_are_missed(tmp_path):
    run = load_run(write_run(tmp_path / 'run', [5] * 20, test=[-50] * 100, dummy=[-60]))
    assert [verdict.word for verdict in judge(run)] == ['fail'] * 4


def test_what_is_not_there_is_not_judged(tmp_path):
    run = load_run(write_run(tmp_path / 'run', [1], test=[900] * 99))
    assert [verdict.word for verdict in judge(run)] == ['not judged'] * 4
    run.evaluation = None
    assert all(verdict.text for verdict in judge(run))


def test_every_figure_has_a_text_even_without_records(tmp_path):
    run = load_run(write_run(tmp_path / 'run', [3], validations=()))
    run.config = {}
    rows = compare(run)
    assert [figure for figure, _ in rows] == list(FIGURES)
    for figure, measured in rows:
        assert measured.text, figure.key
        assert (measured.value is None) == measured.text.startswith('–'), figure.key


def test_the_document_is_data():
    assert len({figure.key for figure in FIGURES}) == len(FIGURES)
    assert len(OBJECTIVES) == 4
    for figure in FIGURES:
        if figure.value is not None:
            digits = figure.stated.replace('~', '').split()[0].rstrip('%')
            if digits not in ('never', 'none', 'at'):
                assert float(digits) == figure.value, figure.key
