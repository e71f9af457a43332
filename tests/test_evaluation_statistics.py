# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics against numbers worked out by hand."""
from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.statistics import (
    mean_interval, moving_average, percent, share_interval, statistics_of,
)
from evaluation_cases import lap
import numpy as np
import pytest

LAPS = [
    lap(1, 700, frames=900, standing_still=101),
    lap(2, 800, frames=1000, standing_still=100),
    lap(3, 900, frames=600, lap_finished=True, tiles_visited=300),
    lap(4, 920, frames=700, lap_finished=True, tiles_visited=300),
    lap(5, 180, frames=300, left_field=True, tiles_visited=90),
]


def test_the_numbers_of_five_laps():
    numbers = statistics_of(LAPS)
    assert numbers.episodes == 5
    assert numbers.mean == 700
    # deviations 0, 100, 200, 220, -520: squares add up to 368800
    assert numbers.std == pytest.approx((368800 / 5) ** 0.5)
    assert (numbers.minimum, numbers.median, numbers.maximum) == (180, 800, 920)
    # linear between neighbours: place 0.4 of 0..4 is 180 + 0.4 * 520
    assert numbers.quantiles[0.10] == pytest.approx(388)
    assert numbers.quantiles[0.25] == 700
    assert numbers.quantiles[0.90] == pytest.approx(912)
    assert numbers.completed == 0.4
    assert numbers.success == {700: 0.8, 800: 0.6, 900: 0.4}
    assert numbers.stopped == 0.2
    assert numbers.left_field == 0.2
    assert numbers.frames == 700
    assert numbers.lap_frames == 650
    assert numbers.tiles == pytest.approx((0.9 + 0.9 + 1 + 1 + 0.3) / 5)


def test_the_order_of_laps_does_not_matter():
    assert statistics_of(LAPS[::-1]) == statistics_of(LAPS)


def test_no_lap_has_no_statistics():
    with pytest.raises(EvaluationError, match='no lap'):
        statistics_of([])


def test_one_lap():
    numbers = statistics_of(LAPS[:1])
    assert (numbers.mean_low, numbers.mean, numbers.mean_high) == (700, 700, 700)
    assert numbers.std == 0
    assert numbers.lap_frames is None


def test_interval_of_equal_values_is_that_value():
    assert mean_interval(np.full(7, 3.5)) == (3.5, 3.5)


def test_interval_of_a_mean_is_near_the_normal_one():
    values = np.random.default_rng(1).normal(500, 100, 400)
    low, high = mean_interval(values)
    error = values.std() / 20
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.1 * error)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.1 * error)
    assert mean_interval(values) == (low, high)


def test_wilson_interval_against_published_values():
    # R. Newcombe, Statistics in Medicine 17, 857, table I: 81 of 263 and 0 of 20
    assert share_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert share_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert share_interval(20, 20)[1] == 1.0


def test_moving_average_has_shorter_windows_at_the_start():
    assert moving_average(np.array([1.0, 3, 5, 7]), 2).tolist() == [1, 2, 4, 6]


def test_moving_average_leaves_gaps_out():
    nan = float('nan')
    averages = moving_average(np.array([nan, 2.0, nan, 4, nan, nan]), 2)
    np.testing.assert_equal(averages, [nan, 2, 2, 4, 4, nan])


@pytest.mark.parametrize(('share', 'text'), [
    (0.0, '0%'), (1.0, '100%'), (0.5, '50%'), (0.997, '99.7%'), (0.9999, '99.9%'),
    (0.004, '0.4%'), (1e-9, '0.1%'), (299 / 300, '99.7%')])
def test_all_and_none_are_said_of_all_and_none_alone(share, text):
    assert percent(share) == text
