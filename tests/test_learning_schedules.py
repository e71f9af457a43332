# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Epsilon, learning rate, limiter and presets, with numbers worked out by hand."""
import dataclasses

from dqn_policy_node.errors import ModelError
from learning_cases import tiny
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import describe
import pytest
from trainer_node.hyperparameters import Hyperparameters, load_preset, to_yaml
from trainer_node.limiter import ReplayRatioLimiter
from trainer_node.schedules import epsilon, LearningRate
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


def test_a_better_reward_may_bring_the_first_rate_back():
    rate = LearningRate(Hyperparameters(learning_rate_schedule='plateau_reset'))
    rate.episode_ended(5.0)
    for _ in range(400):
        rate.episode_ended(4.0)
    assert rate.value == 2.5e-5
    rate.episode_ended(6.0)
    assert rate.value == 1e-4


def test_a_linear_learning_rate_holds_and_then_falls():
    rate = LearningRate(tiny(
        learning_rate=1e-3, learning_rate_end=1e-4, learning_rate_schedule='linear',
        learning_rate_hold=0.5))
    values = []
    for progress in (0.0, 0.5, 0.75, 1.0):
        rate.progressed(progress)
        values.append(rate.value)
    assert values == pytest.approx([1e-3, 1e-3, 5.5e-4, 1e-4])
    # held to the end, by a run that is resumed after it has fallen
    held = LearningRate(tiny(
        learning_rate=1e-3, learning_rate_end=1e-4, learning_rate_schedule='linear',
        learning_rate_hold=1.0))
    held.restore(rate.state())
    held.progressed(1.0)
    assert held.value == 1e-3


def test_the_limiter_counts_from_when_learning_starts():
    limiter = ReplayRatioLimiter(8.0, 32, 10)
    assert updates_of(limiter, 30) == [0] * 10 + [0, 0, 0, 1] * 5
    assert limiter.ratio == 8.0


def after_resume(limiter, **changes):
    values = {'samples_per_transition': limiter.samples_per_transition,
              'batch_size': limiter.batch_size, 'learning_starts': limiter.learning_starts}
    later = ReplayRatioLimiter(**{**values, **changes})
    later.restore(limiter.state())
    return later


def updates_of(limiter, transitions):
    """Return how many updates are due after each of some transitions."""
    made = []
    for _ in range(transitions):
        limiter.insert()
        made.append(0)
        while limiter.due():
            limiter.sampled()
            made[-1] += 1
    return made


@pytest.mark.parametrize('changes, expected', [
    ({}, [0, 0, 0, 1] * 4),
    ({'samples_per_transition': 16.0}, [0, 1] * 8),
    ({'samples_per_transition': 4.0}, ([0] * 7 + [1]) * 2),
    ({'batch_size': 64}, ([0] * 7 + [1]) * 2),
    ({'batch_size': 8}, [1] * 16),
    ({'learning_starts': 400_008}, [0] * 11 + [1, 0, 0, 0, 1]),
    ({'learning_starts': 10}, [0, 0, 0, 1] * 4),
])
def test_a_resumed_limiter_has_no_burst_and_no_drought(changes, expected):
    limiter = ReplayRatioLimiter(8.0, 32, 2000)
    limiter.transitions, limiter.counted, limiter.samples = 400_000, 398_000, 398_000 * 8
    assert updates_of(after_resume(limiter, **changes), 16) == expected


def test_credit_for_a_larger_batch_is_worth_one_update():
    limiter = ReplayRatioLimiter(1.0, 4096, 1)
    updates_of(limiter, 4000)
    assert sum(updates_of(after_resume(limiter, batch_size=1), 3)) == 4


@pytest.mark.parametrize('schedule', ['constant', 'plateau', 'linear'])
def test_another_learning_rate_is_the_one_that_a_resumed_run_uses(schedule):
    own = tiny(learning_rate=1e-3, learning_rate_schedule=schedule, patience_episodes=2)
    rate = LearningRate(own)
    for reward in (5.0, 1.0, 1.0, 1.0):
        rate.episode_ended(reward)
    rate.progressed(0.25)
    for changes, expected in (
        ({}, rate.value), ({'learning_rate': 1e-5}, 1e-5 if schedule != 'linear' else 7.75e-6),
        ({'learning_rate_end': 9e-4}, 9.75e-4 if schedule == 'linear' else max(rate.value, 9e-4)),
    ):
        later = LearningRate(dataclasses.replace(own, **changes))
        later.restore(rate.state())
        later.progressed(0.25)
        assert later.value == pytest.approx(expected), changes
        assert later.best_reward == 5.0


def test_a_high_ratio_gives_several_updates_for_one_transition():
    assert updates_of(ReplayRatioLimiter(24.0, 8, 1), 2) == [0, 3]


def test_the_defaults_are_the_report_but_for_readings_that_its_curve_chose():
    own = load_preset('report')
    assert dataclasses.replace(
        own, weights_every=100, action_repeat=1, samples_per_transition=8.0, loss='l1',
    ) == Hyperparameters()
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
              'tile_missed_limit', 'early_end_terminal', 'quantiles', 'tuner_step', 'tuner_least',
              'epsilon_spread', 'demonstrations', 'demonstration_weight', 'demonstration_margin',
              'demonstration_updates', 'demonstration_share', 'flush_denormals',
              'track_retries'}
    assert set(describe(Hyperparameters)) - set(values) == unused


@pytest.mark.parametrize(('text', 'message'), [
    ('gama: 0.9', "unknown setting 'gama'; did you mean 'gamma'"),
    ('gamma: 2.0', 'gamma is 2.0; accepted: 0 to 1'),
    ('gamma: [1]', 'gamma must be a number'),
    ('- 1', 'must be a mapping'),
    ('a: b: c', 'is not valid YAML'),
    ('epsilon_end: 0.5\nepsilon_start: 0.1', 'epsilon_end 0.5 is above'),
    ('learning_rate_end: 0.1', 'learning_rate_end 0.1 is above'),
    ('learning_starts: 200000', 'learning_starts 200000 must be below'),
    ('track_retries: 2', 'never comes back to one'),
    ('5: 6', 'unknown setting 5'),
    ('gamma: 0.5\ngamma: 0.9', "'gamma' comes twice"),
    ('gamma: 1' + '0' * 400, 'so many digits'), ('hidden: 0x' + 'f' * 5000, 'so many digits'),
    *((f'gamma: !!{tag} "{text}"', 'is not valid YAML') for tag, text in (
        ('bool', 'x'), ('float', ''), ('int', ''), ('timestamp', 'x'), ('map', 'xy'))),
])
def test_bad_presets_are_refused_with_the_reason(tmp_path, text, message):
    (tmp_path / 'bad.yaml').write_text(text)
    with pytest.raises(SettingsError, match=message):
        load_preset(tmp_path / 'bad.yaml')


def test_presets_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(SettingsError, match="no preset 'raicing'"):
        load_preset('raicing')
    for name in ('~nobody_of_that_name/x', 'a' * 5000, 'a\0b'):
        with pytest.raises(SettingsError, match='no preset'):
            load_preset(name)
    (tmp_path / 'bytes.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(SettingsError, match='is not valid YAML'):
        load_preset(tmp_path / 'bytes.yaml')
    with pytest.raises(SettingsError, match='did you mean'):
        load_preset('report', {'batchsize': 3})
    assert load_preset('report', {'batch_size': 64}).batch_size == 64


def test_a_network_that_cannot_be_is_refused():
    with pytest.raises(ModelError, match='does not fit'):
        Hyperparameters(shrink=8, convolutions='32@8/4 64@4/2')
