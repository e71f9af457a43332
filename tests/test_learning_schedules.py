# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Epsilon, learning rate, limiter, shaping and presets, with numbers worked out by hand."""
import dataclasses
import math

from dqn_policy_node.errors import ModelError
from learning_cases import make_step, tiny
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import describe
import pytest
from trainer_node.hyperparameters import Hyperparameters, load_preset, to_yaml
from trainer_node.limiter import ReplayRatioLimiter
from trainer_node.schedules import epsilon, LearningRate
from trainer_node.shaping import shaped_reward, shaping_terms, standing_points
import yaml


def test_epsilon_of_the_report_falls_by_episodes():
    report = Hyperparameters()
    assert epsilon(report, episodes=0, decisions=10**6) == 1.0
    assert epsilon(report, episodes=100, decisions=0) == pytest.approx(0.995 ** 100)
    assert epsilon(report, episodes=2000, decisions=0) == 0.01


def test_epsilon_by_decisions_is_a_line():
    own = tiny(epsilon_schedule='decisions', epsilon_decisions=100, epsilon_start=0.9,
               epsilon_end=0.1)
    assert [epsilon(own, episodes=5, decisions=d) for d in (0, 50, 100, 1000)] == pytest.approx(
        [0.9, 0.5, 0.1, 0.1])


def test_the_learning_rate_of_the_report_is_halved_on_plateaus_only():
    rate = LearningRate(Hyperparameters())
    rate.episode_ended(5.0)
    for _ in range(199):
        rate.episode_ended(4.0)
    assert rate.value == 1e-4
    rate.episode_ended(5.0)
    assert rate.value == 5e-5
    for _ in range(199):
        rate.episode_ended(1.0)
    rate.episode_ended(6.0)
    for _ in range(199):
        rate.episode_ended(1.0)
    assert rate.value == 5e-5
    for _ in range(200 * 20):
        rate.episode_ended(1.0)
    assert rate.value == 1e-6


def test_a_linear_learning_rate_holds_and_then_falls():
    rate = LearningRate(tiny(
        learning_rate=1e-3, learning_rate_end=1e-4, learning_rate_schedule='linear',
        learning_rate_hold=0.5))
    values = []
    for progress in (0.0, 0.5, 0.75, 1.0):
        rate.progressed(progress)
        values.append(rate.value)
    assert values == pytest.approx([1e-3, 1e-3, 5.5e-4, 1e-4])


def test_the_limiter_counts_from_when_learning_starts():
    limiter = ReplayRatioLimiter(8.0, 32, 10)
    updates = []
    for _ in range(30):
        limiter.insert()
        while limiter.due():
            limiter.sampled()
        updates.append(limiter.updates)
    assert updates[9:15] == [0, 0, 0, 0, 1, 1]
    assert updates[-1] == 5
    assert limiter.ratio == 8.0


def test_a_high_ratio_gives_several_updates_for_one_transition():
    limiter = ReplayRatioLimiter(24.0, 8, 0)
    limiter.insert()
    made = 0
    while limiter.due():
        limiter.sampled()
        made += 1
    assert made == 3


def test_without_weights_the_reward_is_the_environments_own():
    after = make_step(reward=3.25, tiles_missed=4, wheels_off_road=1, standing_still=90,
                      speed=50, lap_finished=1, ended_early=1, left_field=1)
    assert shaped_reward(tiny(), after, make_step()) == 3.25


def test_each_term_by_hand():
    own = tiny(tile_missed_penalty=10, off_road_penalty=0.1, progress_weight=30, speed_weight=0.5,
               time_penalty=0.2, finish_bonus=20, left_field_refund=90, early_end_penalty=7,
               position_weight=60)
    after = make_step(tiles_missed=5, lap_position=15, tiles_visited=12, wheels_off_road=0.5,
                      speed=40, lap_finished=1, left_field=1, ended_early=1, frames=3, reward=1)
    before = make_step(tiles_missed=3, tiles_visited=10, lap_position=20)
    terms = shaping_terms(own, after, before)
    assert terms == pytest.approx({
        'tile_missed': -20, 'off_road': -0.15, 'standing': 0, 'progress': 0.2, 'position': -1.0,
        'speed': 0.6,
        'time': -0.6, 'finish': 20, 'left_field': 90, 'early_end': -7})
    scaled = dataclasses.replace(own, reward_scale=0.1)
    assert shaped_reward(scaled, after, before) == (
        pytest.approx(0.1 * (1 + sum(terms.values()))))


def test_who_comes_round_is_paid_whatever_was_missed_and_not_fined_for_the_end():
    came = make_step(ended_early=1, came_round=1)
    terms = shaping_terms(tiny(finish_bonus=20, early_end_penalty=7), came, make_step())
    assert (terms['finish'], terms['early_end']) == (20, 0)


def test_the_penalty_of_one_decision_for_missed_tiles_has_a_limit():
    own = tiny(tile_missed_penalty=10, tile_missed_limit=25)
    for missed, points in ((1, -10), (2, -20), (3, -25), (40, -25)):
        assert shaping_terms(
            own, make_step(tiles_missed=missed), make_step())['tile_missed'] == points


def test_a_missed_tile_that_is_fetched_gives_its_points_back():
    own = tiny(tile_missed_penalty=10)
    back = shaping_terms(own, make_step(tiles_missed=1), make_step(tiles_missed=2))
    assert back['tile_missed'] == 10


def test_standing_still_costs_exponentially_more_up_to_a_limit():
    own = tiny(standing_penalty=0.5, standing_growth=2.0, standing_limit=10.0)
    assert standing_points(own, 0, 4) == 0
    assert standing_points(own, 3, 4) == pytest.approx(0.5 + 1 + 2)
    assert standing_points(own, 4, 2) == pytest.approx(2 + 4)
    assert standing_points(own, 100000, 4) == pytest.approx(40)
    assert math.isfinite(standing_points(tiny(standing_penalty=1e-9), 10**6, 4))


def test_the_defaults_are_the_report():
    own = load_preset('report')
    assert dataclasses.replace(own, weights_every=100) == Hyperparameters()
    assert (own.gamma, own.batch_size, own.replay_capacity) == (0.99, 32, 100_000)


@pytest.mark.parametrize('name', ['report', 'racing'])
def test_presets_say_only_what_is_known_and_survive_yaml(name, tmp_path):
    own = load_preset(name)
    (tmp_path / 'copy.yaml').write_text(to_yaml(own))
    assert load_preset(tmp_path / 'copy.yaml') == own


def test_the_report_preset_names_every_number_that_it_could_change():
    from msgs_bridge.share import share_path
    values = yaml.safe_load(share_path('config/report.yaml').read_text())
    unused = {'learning_rate_hold', 'epsilon_decisions', 'standing_growth', 'standing_limit',
              'tile_missed_limit', 'early_end_terminal'}
    assert set(describe(Hyperparameters)) - set(values) == unused


@pytest.mark.parametrize(('text', 'message'), [
    ('gama: 0.9', "unknown setting 'gama'; did you mean 'gamma'"),
    ('gamma: 2.0', 'gamma is 2.0; accepted: 0 to 1'),
    ('gamma: [1]', 'gamma must be a number'),
    ('- 1', 'must be a mapping'),
    ('a: b: c', 'is not YAML'),
    ('epsilon_end: 0.5\nepsilon_start: 0.1', 'epsilon_end 0.5 is above'),
    ('learning_rate_end: 0.1', 'learning_rate_end 0.1 is above'),
    ('learning_starts: 200000', 'learning_starts 200000 must be below'),
    ('5: 6', 'unknown setting 5'),
])
def test_bad_presets_are_refused_with_the_reason(tmp_path, text, message):
    (tmp_path / 'bad.yaml').write_text(text)
    with pytest.raises(SettingsError, match=message):
        load_preset(tmp_path / 'bad.yaml')


def test_presets_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(SettingsError, match="no preset 'raicing'"):
        load_preset('raicing')
    (tmp_path / 'bytes.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(SettingsError, match='is not YAML'):
        load_preset(tmp_path / 'bytes.yaml')
    with pytest.raises(SettingsError, match='did you mean'):
        load_preset('report', {'batchsize': 3})
    assert load_preset('report', {'batch_size': 64}).batch_size == 64


def test_a_network_that_cannot_be_is_refused():
    with pytest.raises(ModelError, match='does not fit'):
        Hyperparameters(shrink=8, convolutions='32@8/4 64@4/2')
