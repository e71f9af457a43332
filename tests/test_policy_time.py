# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""When a policy decides: any frame rate, any stamps."""
from dqn_policy_node.action_hold import ActionHold
from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.image_time import ImageTime, Place, RISING
from dqn_policy_node.pilot import Pilot
from dqn_policy_node.policy import RandomPolicy
from hypothesis import given, settings, strategies
import numpy as np
import pytest

MS = 1_000_000
FRAME = np.zeros((96, 96, 3), np.uint8)
OTHER = np.ones((96, 96, 3), np.uint8)


def decisions(stamps, held=80 * MS):
    """Return the stamps that are decided on."""
    hold = ActionHold()
    return [stamp for stamp in stamps if hold.is_due(stamp, held)]


@pytest.mark.parametrize('hertz', [200, 50, 30, 25, 15])
def test_an_action_is_held_for_its_time_at_any_frame_rate(hertz):
    found = np.diff(decisions([round(n * 1e9 / hertz) for n in range(20 * hertz)]))
    assert found.mean() == pytest.approx(80 * MS, rel=0.05)
    # nothing is decided on by more than a frame, or an eighth of the time, early or late
    assert abs(found - 80 * MS).max() <= max(1e9 / hertz, 10 * MS)


def test_of_fifty_frames_a_second_every_fourth_is_decided_on_jitter_or_not():
    stamps = np.arange(400) * 20 * MS
    jitter = np.random.default_rng(0).integers(-9 * MS, 9 * MS, 400)
    jitter[0] = 0
    assert decisions(stamps) == list(stamps[::4])
    assert decisions(stamps + jitter) == list((stamps + jitter)[::4])


def test_a_camera_slower_than_actions_is_decided_on_frame_by_frame():
    stamps = [n * 100 * MS for n in range(50)]
    assert decisions(stamps) == stamps
    assert decisions(stamps, held=0) == stamps


def test_late_frames_do_not_make_up_for_lost_time():
    found = decisions([0, 80 * MS, 150 * MS, 390 * MS, 400 * MS, 420 * MS, 430 * MS, 480 * MS])
    assert found == [0, 80 * MS, 150 * MS, 390 * MS, 420 * MS]


def places(*images, gap=500 * MS):
    """Return where images of (stamp, arrival, same) in ms stand, and ms since the one before."""
    time = ImageTime(gap)
    found = [time.place(stamp * MS, arrived * MS, lambda same=same: same)
             for stamp, arrived, same in images]
    return [(place, elapsed // MS) for place, elapsed in found]


def test_only_differences_of_stamps_count():
    for start in (0, 1_700_000_000_000, -5000):
        assert places((start, 0, False), (start + 33, 90, False), (start + 67, 91, False)) == [
            (Place.FIRST, 0), (Place.NEXT, 33), (Place.NEXT, 34)]


def test_an_image_sent_again_is_none():
    assert places((5, 0, False), (5, 900, True), (25, 920, False)) == [
        (Place.FIRST, 0), (Place.AGAIN, 0), (Place.NEXT, 20)]


def test_a_stamp_that_stands_is_replaced_by_the_time_of_arrival_until_stamps_rise_again():
    assert places((0, 100, False), (0, 133, False), (0, 170, False), (0, 900, False)) == [
        (Place.FIRST, 0), (Place.NEXT, 33), (Place.NEXT, 37), (Place.FIRST, 0)]
    rising = [(n * 20, 1000 + n * 30, False) for n in range(1, RISING + 3)]
    found = places((0, 970, False), (0, 1000, False), *rising)
    assert [elapsed for _, elapsed in found] == [0] + [30] * RISING + [20] * 3
    assert [place for place, _ in found].count(Place.FIRST) == 1


def test_time_that_goes_back_or_jumps_ahead_begins_a_sequence():
    assert [place for place, _ in places(
        (9000, 0, False), (9020, 1, False), (0, 2, False), (20, 3, False), (700, 4, False))] == [
        Place.FIRST, Place.NEXT, Place.FIRST, Place.NEXT, Place.FIRST]


def test_one_late_image_changes_nothing_and_two_mean_that_time_went_back():
    late = [place for place, _ in places(
        (100, 0, False), (120, 1, False), (110, 2, False), (140, 3, False))]
    assert late == [Place.FIRST, Place.NEXT, Place.LATE, Place.NEXT]
    back = [place for place, _ in places(
        (300, 0, False), (0, 1, False), (20, 2, False), (40, 3, False))]
    assert back == [Place.FIRST, Place.LATE, Place.FIRST, Place.NEXT]


def test_a_resent_frame_gets_the_same_answer_and_a_held_one_its_command():
    pilot = Pilot(RandomPolicy(ACTION_SPACES['grid9'], action_seconds=0.08, seed=1))
    first = pilot.answer(0, FRAME, 0)
    assert pilot.answer(0, FRAME.copy(), 5) is first and first.decided
    held = pilot.answer(20 * MS, OTHER, 20)
    assert not held.decided and held.command == first.command
    assert pilot.answer(40 * MS, OTHER, 40) is held
    assert pilot.answer(80 * MS, OTHER, 80).decided and pilot.sequences == 1


def test_a_camera_without_stamps_is_looked_at():
    pilot = Pilot(RandomPolicy(ACTION_SPACES['grid9'], seed=1))
    answers = [pilot.answer(0, np.full((96, 96, 3), n, np.uint8), n * 33 * MS) for n in range(60)]
    assert all(answer.decided for answer in answers) and pilot.sequences == 1
    assert len({answer.action for answer in answers}) > 3


@settings(max_examples=200, deadline=None)
@given(strategies.lists(strategies.tuples(
    strategies.one_of(strategies.integers(-2**31, 2**31).map(lambda s: s * 10**9),
                      strategies.integers(0, 50).map(lambda n: n * 20 * MS)),
    strategies.booleans()), max_size=60))
def test_whatever_the_stamps_every_image_is_answered(images):
    pilot = Pilot(RandomPolicy(ACTION_SPACES['seed5'], action_seconds=0.08, seed=1))
    for number, (stamp, other) in enumerate(images):
        answer = pilot.answer(stamp, OTHER if other else FRAME, number * 20 * MS)
        assert answer.command in ACTION_SPACES['seed5'].commands
        assert pilot.elapsed >= 0
