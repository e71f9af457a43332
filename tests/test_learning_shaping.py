# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Shaping: each term by hand, flags that stay set, and steps that lack what a term needs."""
import dataclasses
import math

from learning_cases import make_step, make_transition, tiny
from msgs_bridge.errors import MessageError
import pytest
from trainer_node.errors import LearningError
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.shaping import REWARD_SETTINGS, Shaping, standing_points, TERMS


def points(own, after, before=None, **changes):
    return Shaping(own).terms(make_transition(
        step=after, previous=before or make_step(), **changes))


def without(step, name):
    return dataclasses.replace(
        step, info={key: value for key, value in step.info.items() if key != name})


def test_without_weights_the_reward_is_the_environments_own_and_no_info_is_needed():
    bare = dataclasses.replace(make_step(reward=3.25), info={})
    assert Shaping(tiny()).reward(make_transition(step=bare, previous=bare)) == 3.25
    after = make_step(reward=3.25, tiles_missed=4, wheels_off_road=1, standing_still=90,
                      speed=50, lap_finished=1, ended_early=1, left_field=1)
    assert Shaping(tiny()).reward(make_transition(step=after)) == 3.25


def test_each_term_by_hand():
    own = tiny(tile_missed_penalty=10, off_road_penalty=0.1, progress_weight=30, speed_weight=0.5,
               time_penalty=0.2, finish_bonus=20, left_field_refund=90, early_end_penalty=7,
               position_weight=60, standing_penalty=0.5, standing_growth=1.0)
    after = make_step(tiles_missed=5, lap_position=15, tiles_visited=12, wheels_off_road=0.5,
                      speed=40, lap_finished=1, left_field=1, ended_early=1, reward=1,
                      standing_still=2)
    before = make_step(tiles_missed=3, tiles_visited=10, lap_position=20)
    terms = points(own, after, before, next_stamp=60_000_000)
    assert terms == pytest.approx({
        'tile_missed': -20, 'off_road': -0.15, 'standing': -1, 'progress': 0.2, 'position': -1.0,
        'speed': 0.6, 'time': -0.6, 'finish': 20, 'left_field': 90, 'early_end': -7})
    assert terms.keys() == TERMS.keys()
    scaled = Shaping(dataclasses.replace(own, reward_scale=0.1))
    assert scaled.reward(make_transition(
        step=after, previous=before, next_stamp=60_000_000)) == (
        pytest.approx(0.1 * (1 + sum(terms.values()))))


@pytest.mark.parametrize('setting, flag', [
    ('finish_bonus', 'lap_finished'), ('finish_bonus', 'came_round'),
    ('left_field_refund', 'left_field'), ('early_end_penalty', 'ended_early')])
def test_what_an_event_is_worth_is_paid_once_however_long_its_flag_stays_set(setting, flag):
    shaping = Shaping(tiny(**{setting: 20.0}))
    steps = [make_step(**{flag: value}) for value in (0, 1, 1, 1)]
    paid = [sum(shaping.terms(make_transition(step=after, previous=before)).values())
            for before, after in zip(steps, steps[1:])]
    assert [abs(value) for value in paid] == [20, 0, 0]


def test_a_lap_that_comes_round_and_is_finished_later_is_paid_once():
    shaping = Shaping(tiny(finish_bonus=20.0))
    steps = [make_step(), make_step(came_round=1), make_step(came_round=1, lap_finished=1)]
    assert [shaping.terms(make_transition(step=after, previous=before))['finish']
            for before, after in zip(steps, steps[1:])] == [20, 0]


def test_who_comes_round_is_paid_whatever_was_missed_and_not_fined_for_the_end():
    came = make_step(ended_early=1, came_round=1)
    terms = points(tiny(finish_bonus=20, early_end_penalty=7), came)
    assert (terms['finish'], terms['early_end']) == (20, 0)


def test_the_penalty_of_one_decision_for_missed_tiles_has_a_limit():
    own = tiny(tile_missed_penalty=10, tile_missed_limit=25)
    for missed, expected in ((1, -10), (2, -20), (3, -25), (40, -25)):
        assert points(own, make_step(tiles_missed=missed))['tile_missed'] == expected


def test_a_missed_tile_that_is_fetched_gives_its_points_back():
    back = points(tiny(tile_missed_penalty=10), make_step(tiles_missed=1),
                  make_step(tiles_missed=2))
    assert back['tile_missed'] == 10


def test_standing_still_costs_exponentially_more_up_to_a_limit():
    own = tiny(standing_penalty=0.5, standing_growth=2.0, standing_limit=10.0)
    assert standing_points(own, 0, 4) == 0
    assert standing_points(own, 3, 4) == pytest.approx(0.5 + 1 + 2)
    assert standing_points(own, 4, 2) == pytest.approx(2 + 4)
    assert standing_points(own, 100000, 4) == pytest.approx(40)
    assert math.isfinite(standing_points(tiny(standing_penalty=1e-9), 10**6, 4))


def test_stamps_that_are_ages_apart_cost_no_time_to_add_up():
    own = tiny(standing_penalty=0.5, time_penalty=1.0)
    terms = points(own, make_step(standing_still=1e15), next_stamp=2**62)
    assert terms['time'] == -3000


def test_what_is_paid_by_time_does_not_depend_on_a_simulators_frames():
    own = tiny(time_penalty=0.1)
    for frames in (1, 4, 50):
        assert points(own, make_step(frames=frames), next_stamp=80_000_000)['time'] == (
            pytest.approx(-0.4))


@pytest.mark.parametrize('term', [name for name in TERMS if TERMS[name].info])
def test_a_term_that_nobody_publishes_is_refused_by_name_at_the_first_transition(term):
    weight = TERMS[term].weight
    for needed in TERMS[term].info:
        for which in ('step', 'previous'):
            transition = make_transition(**{which: without(make_step(), needed)})
            with pytest.raises(LearningError, match=f"{weight} is 0.5 and needs '{needed}'") as e:
                Shaping(tiny(**{weight: 0.5})).reward(transition)
            assert '\n' not in str(e.value)
            assert f'{weight}=0' in str(e.value)
            assert Shaping(tiny()).reward(transition) == 0


def test_the_limit_of_frames_may_be_kept_as_done():
    cut, ended = (make_transition(step=make_step(**{name: 1.0}))
                  for name in ('truncated', 'terminated'))
    for flag in (False, True):
        shaping = Shaping(tiny(truncated_terminal=flag))
        assert shaping.terminated(cut) is flag and shaping.terminated(ended)
        assert not shaping.terminated(make_transition())


def test_an_early_end_that_is_terminal_needs_to_be_told_of_it():
    shaping = Shaping(tiny(early_end_terminal=True))
    with pytest.raises(LearningError, match="needs 'ended_early'.*early_end_terminal=false"):
        shaping.reward(make_transition(step=without(make_step(), 'ended_early')))
    assert shaping.terminated(make_transition(step=make_step(ended_early=1, truncated=1)))
    assert not Shaping(tiny()).terminated(
        make_transition(step=make_step(ended_early=1, truncated=1)))


def test_what_does_not_end_is_not_terminal_whatever_its_info_says():
    """Rewards that follow would be added to a return that has ended."""
    shaping = Shaping(tiny(early_end_terminal=True))
    assert not shaping.terminated(make_transition(step=make_step(ended_early=1)))


@pytest.mark.parametrize('values', [
    {'speed': 1.7e308, 'wheels_off_road': 1.7e308}, {'speed': 5e305, 'wheels_off_road': -5e303}])
def test_terms_that_cannot_be_added_up_cost_their_transition_only(values):
    shaping = Shaping(tiny(speed_weight=10.0, off_road_penalty=10.0))
    shaping.reward(make_transition())
    with pytest.raises(MessageError, match='the shaped reward is'):
        shaping.reward(make_transition(step=make_step(**values), next_stamp=10**12))
    assert shaping.reward(make_transition()) == 0.0


def test_a_later_step_that_lacks_a_value_costs_its_transition_only():
    shaping = Shaping(tiny(speed_weight=0.5))
    shaping.reward(make_transition())
    with pytest.raises(MessageError, match="step lacks 'speed'"):
        shaping.reward(make_transition(step=without(make_step(), 'speed')))
    with pytest.raises(MessageError, match='reward is inf'):
        shaping.reward(make_transition(step=make_step(speed=1.7e308), next_stamp=10**12))
    assert shaping.reward(make_transition(step=make_step(speed=100.0))) == pytest.approx(2.0)


def test_every_shaping_setting_belongs_to_a_term():
    names = list(Hyperparameters.__dataclass_fields__)
    section = names[names.index('tile_missed_penalty'):names.index('weights_every')]
    assert set(section) | {'reward_scale'} == set(REWARD_SETTINGS)


def test_a_reward_that_no_replay_can_hold_costs_its_transition_only():
    shaping = Shaping(tiny(speed_weight=1.0))
    previous = make_step()
    for speed in (1e300, -1e300, 1e39):
        with pytest.raises(MessageError, match='the shaped reward is'):
            shaping.reward(make_transition(previous=previous, step=make_step(speed=speed)))
