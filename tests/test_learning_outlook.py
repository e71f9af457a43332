# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where a run by the clock ends: epsilon at its end, and a machine that is too slow for it."""
import pytest
from trainer_node.hyperparameters import from_mapping, Hyperparameters, load_preset
from trainer_node.model_selection import Moment
from trainer_node.outlook import Outlook


def after(settings, *paces):
    """Return the outlook of a run that went by (seconds, decisions/s, episodes/s) one by one."""
    outlook, clock, decisions, episodes = Outlook(settings), 0.0, 0.0, 0.0
    for seconds, faster, ends in paces:
        for _ in range(int(seconds)):
            outlook.note(Moment(int(episodes), int(decisions), 0, clock))
            clock, decisions, episodes = clock + 1, decisions + faster, episodes + ends
    return outlook


def test_a_machine_that_is_fast_enough_is_not_complained_of():
    outlook = after(load_preset('racing'), (62, 100, 1))
    assert outlook.epsilon == pytest.approx(0.03) and not outlook.warning


def test_a_slow_machine_is_told_of_after_the_first_minute_with_what_fits():
    settings = load_preset('racing', {'run_minutes': 12.0})
    assert after(settings, (60, 60, 1)).epsilon is None
    outlook = after(settings, (62, 60, 1))
    # 60 decisions/s for 12 minutes are 43,200 of the 100,000 over which epsilon falls
    assert outlook.epsilon == pytest.approx(1 - 0.97 * 0.432, abs=0.01)
    assert '60 decisions/s epsilon ends at 0.58, not 0.03' in outlook.warning
    name, _, value = outlook.warning.rpartition(' ')[2].partition('=')
    fits = load_preset('racing', {'run_minutes': 12.0, name: int(value)})
    assert not after(fits, (62, 60, 1)).warning


def test_the_pace_is_that_of_now():
    settings = load_preset('racing')
    assert after(settings, (62, 5, 0.1)).warning
    assert not after(settings, (62, 5, 0.1), (80, 100, 1)).warning
    # before anything is learned it goes fast
    assert after(settings, (30, 500, 1), (62, 5, 0.1)).warning


def test_epsilon_by_episodes_has_a_decay_that_fits():
    settings = load_preset('report', {'run_minutes': 30.0})
    outlook = after(settings, (62, 60, 0.05))
    assert '3.0 episodes/min' in outlook.warning
    name, _, value = outlook.warning.rpartition(' ')[2].partition('=')
    fits = load_preset('report', {'run_minutes': 30.0, name: float(value)})
    assert not after(fits, (62, 60, 0.05)).warning


def test_a_run_that_the_clock_does_not_end_has_no_pace_to_keep():
    settings = from_mapping(Hyperparameters, {
        'epsilon_schedule': 'decisions', 'run_decisions': 1000, 'run_episodes': 0})
    outlook = after(settings, (90, 5, 0.1))
    assert outlook.epsilon is None and not outlook.warning
