# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Transitions joined by stamp, whatever the order of arrival and whatever is lost."""
import dataclasses
import itertools

from hypothesis import given, settings, strategies
from msgs_bridge.transitions import TransitionJoiner
from msgs_bridge.step import read_step, STEP_CORE
from msgs_bridge.twists import Command
import numpy as np
import pytest

DECISION = 80_000_000


def drive(episodes=2, decisions=4):
    """Return the (kind, stamp, content) messages of a lockstep drive, topic by topic."""
    images, steps, twists = [], [], []
    stamp = 0
    for episode in range(episodes):
        stamp += 1_000_000_000
        for decision in range(decisions + 1):
            applied = (-1, 0) if decision == 0 else divmod(stamp - DECISION, 10**9)
            images.append(('image', stamp, np.full((2, 2, 3), len(images) % 256, np.uint8)))
            steps.append(('step', stamp, read_step({
                **dict.fromkeys(STEP_CORE, 0.0), 'episode': episode, 'decision': decision,
                'reward': float(len(steps)),
                'terminated': float(decision == decisions), 'truncated': 0.0,
                'applied_sec': applied[0], 'applied_nanosec': applied[1]})))
            twists.append(('twist', stamp, Command(0.0, decision / 10)))
            stamp += DECISION
    return images, steps, twists


def feed(joiner, messages):
    add = {'image': joiner.add_image, 'step': joiner.add_step, 'twist': joiner.add_twist}
    return list(itertools.chain.from_iterable(add[k](stamp, m) for k, stamp, m in messages))


def merge(order, lanes):
    """Interleave lanes by a list of lane numbers, each lane in its own order."""
    lanes = [list(lane) for lane in lanes]
    merged = []
    for number in order:
        if lanes[number]:
            merged.append(lanes[number].pop(0))
    return merged + list(itertools.chain.from_iterable(lanes))


def key(transition):
    return (transition.stamp, transition.next_stamp, transition.command,
            int(transition.frame[0, 0, 0]), int(transition.next_frame[0, 0, 0]),
            transition.step.reward)


def test_every_transition_once_and_right():
    joined = feed(TransitionJoiner(), merge(list(range(3)) * 10, drive()))
    assert len(joined) == 8
    first = joined[0]
    assert (first.stamp, first.next_stamp) == (10**9, 10**9 + DECISION)
    assert first.command == Command(0.0, 0.0) and joined[1].command.angular == 0.1
    assert int(first.frame[0, 0, 0]) == 0 and int(first.next_frame[0, 0, 0]) == 1
    assert first.step.reward == 1.0 and not first.terminated
    assert [t.terminated for t in joined] == [False] * 3 + [True] + [False] * 3 + [True]


@settings(deadline=None)
@given(strategies.lists(strategies.integers(0, 2), max_size=40))
def test_the_order_across_topics_does_not_matter(order):
    expected = feed(TransitionJoiner(), merge(list(range(3)) * 10, drive()))
    joined = feed(TransitionJoiner(), merge(order, drive()))
    assert list(map(key, joined)) == list(map(key, expected))


@settings(deadline=None)
@given(strategies.lists(strategies.integers(0, 2), max_size=40),
       strategies.integers(0, 2), strategies.integers(0, 9))
def test_a_lost_message_costs_only_the_transitions_it_is_part_of(order, lane, place):
    lanes = drive()
    lost = lanes[lane].pop(place)[1]
    expected = [key(t) for t in feed(TransitionJoiner(), merge(list(range(3)) * 10, drive()))]
    joiner = TransitionJoiner()
    joined = [key(t) for t in feed(joiner, merge(order, lanes))]
    touched = [k for k in expected if lost in (k[0],) or (lane != 2 and lost == k[1])]
    # what comes after the last message of a lane can still arrive, so the tail may wait
    newest = max(stamp for _, stamp, _ in lanes[lane])
    if lost < newest:
        assert joined == [k for k in expected if k not in touched]
    else:
        assert set(joined) <= set(expected) - set(touched)


def test_resent_messages_change_nothing():
    messages = merge(list(range(3)) * 10, drive())
    doubled = [m for message in messages for m in (message, message)]
    joiner = TransitionJoiner()
    assert len(feed(joiner, doubled)) == 8
    assert joiner.counts['duplicate'] > 0


@pytest.mark.parametrize('first, last, missing', [
    (2, 3, 1), (1, 4, 3),  # within an episode
    (5, 8, 3), (3, 8, 3),  # the head of the next one; of the end that is gone nothing tells
    (3, 5, 0)])  # an end alone
def test_every_step_of_a_gap_is_counted(first, last, missing):
    images, steps, twists = drive()
    joiner = TransitionJoiner()
    joined = feed(joiner, images + twists + steps[:first] + steps[last:])
    assert joiner.counts['lost_step'] == missing
    assert len(joined) == joiner.counts['joined'] < 8


def test_an_unanswered_frame_is_no_transition():
    images, steps, twists = drive(episodes=1)
    steps[2] = ('step', steps[2][1], dataclasses.replace(steps[2][2], applied=None))
    joiner = TransitionJoiner()
    assert len(feed(joiner, merge(list(range(3)) * 10, (images, steps, twists)))) == 3
    assert joiner.counts['unanswered'] == 1


def saying(step, command):
    """Return a step that says which command was applied."""
    return dataclasses.replace(step, info={'linear': command.linear, 'angular': command.angular})


def with_rival(*, applied, said=True):
    """Return a drive in which a second driver answers every frame, and which twist was applied."""
    images, steps, twists = drive(episodes=1, decisions=6)
    answers = {stamp: (command, Command(1.0, -0.5 - number / 100))
               for number, (_, stamp, command) in enumerate(twists)}
    if said:
        steps = [(kind, stamp, step if step.applied is None else
                  saying(step, answers[step.applied][applied])) for kind, stamp, step in steps]
    both = [('twist', stamp, command) for _, stamp, _ in twists for command in answers[stamp]]
    return (images, steps, both), [answers[stamp][applied] for _, stamp, _ in twists]


@settings(deadline=None)
@given(strategies.lists(strategies.integers(0, 2), max_size=40), strategies.integers(0, 1))
def test_of_two_twists_of_one_stamp_that_is_learned_from_which_was_applied(order, applied):
    """In lockstep the first, in real time the last, whichever topic is heard first."""
    lanes, commands = with_rival(applied=applied)
    joined = feed(TransitionJoiner(), merge(order, lanes))
    assert [one.command for one in joined] == commands[:6]


def test_two_twists_of_which_nothing_tells_which_was_applied_are_counted():
    lanes, _ = with_rival(applied=0, said=False)
    joiner = TransitionJoiner()
    # the second twist comes in time for all but the first transition
    assert not feed(joiner, [*lanes[2], *merge([0, 1] * 10, lanes[:2])])
    assert joiner.counts['twofold'] == 6


def test_a_twist_that_is_not_what_step_says_is_learned_from_where_it_is_the_only_one():
    """A simulator may mean something else by these names; `bag verify` tells of it."""
    images, steps, twists = drive(episodes=1, decisions=6)
    steps = [(kind, stamp, saying(step, Command(0.7, 0.7))) for kind, stamp, step in steps]
    # another one of the first stamp is waited for, and then no more: the last has no successor
    joined = feed(TransitionJoiner(), merge([0, 1, 2] * 10, (images, steps, twists[:6])))
    assert [one.command for one in joined] == [command for _, _, command in twists[:6]]


def test_a_command_beyond_what_a_simulator_takes_is_the_one_that_it_says():
    images, steps, twists = drive(episodes=1, decisions=2)
    twists = [('twist', stamp, Command(3.0, 0.0)) for _, stamp, _ in twists]
    steps = [(kind, stamp, saying(step, Command(1.0, 0.0))) for kind, stamp, step in steps]
    # none is waited for: the last twist is not there
    assert len(feed(TransitionJoiner(), [*images, *steps, *twists[:2]])) == 2


def test_a_flood_of_twists_of_one_stamp_takes_no_memory_and_hides_none():
    (images, steps, _), _ = with_rival(applied=0)
    stamp = steps[0][1]
    joiner = TransitionJoiner()
    joined = feed(joiner, images[:2])
    for number in range(10_000):
        joiner.add_twist(stamp, Command(0.5, number / 10_000))
    assert len(joiner._twists[stamp]) < 10
    joiner.add_twist(stamp, Command(0.25, 0.25))
    joined += feed(joiner, [steps[0], ('step', steps[1][1], saying(
        steps[1][2], Command(0.25, 0.25)))])
    assert [one.command for one in joined] == [Command(0.25, 0.25)]


@settings(deadline=None)
@given(strategies.lists(strategies.booleans(), max_size=60))
def test_two_simulators_under_one_name_are_never_mixed(order):
    """Both begin at the same time, as simulators do, and one driver answers both."""
    drives = [merge([0, 1, 2] * 20, drive()), merge([0, 1, 2] * 20, [
        [(kind, stamp, content if kind == 'twist' else content + 100 if kind == 'image' else
          dataclasses.replace(content, reward=content.reward + 100))
         for kind, stamp, content in lane] for lane in drive()])]
    lines = [iter(one) for one in drives]
    mixed = [message for which in order for message in itertools.islice(lines[which], 1)]
    joiner = TransitionJoiner()
    for one in feed(joiner, [*mixed, *lines[0], *lines[1]]):
        assert len({one.frame[0, 0, 0] < 100, one.next_frame[0, 0, 0] < 100,
                    one.step.reward < 100}) == 1


def test_nothing_follows_the_end_of_an_episode():
    """A simulator that does not count its episodes begins another, elsewhere on the track."""
    images, steps, twists = drive(episodes=1, decisions=8)
    kind, stamp, step = steps[4]
    steps[4] = kind, stamp, dataclasses.replace(step, truncated=True)
    joiner = TransitionJoiner()
    joined = feed(joiner, merge([0, 1, 2] * 20, (images, steps, twists)))
    assert [one.step.decision for one in joined] == [1, 2, 3, 4, 6, 7, 8]
    assert joiner.counts['after_end'] == 1


def test_a_twist_that_is_held_for_seconds_is_not_lost():
    images, steps, twists = drive(episodes=1, decisions=40)
    held = twists[3][1]
    steps = [(kind, stamp, step if step.decision < 5 else dataclasses.replace(step, applied=held))
             for kind, stamp, step in steps]
    joiner = TransitionJoiner()
    joined = feed(joiner, merge([0, 1, 2] * 50, (images, steps, twists)))
    assert len(joined) == 40 and joined[-1].command == twists[3][2]
    assert len(joiner._twists) < 45


def test_time_that_goes_back_joins_nothing_across_the_break():
    messages = merge(list(range(3)) * 10, drive())
    joiner = TransitionJoiner()
    joined = feed(joiner, messages + messages)
    assert joiner.counts['rewound'] == 1
    assert all(0 < t.next_stamp - t.stamp == DECISION for t in joined)
    assert len(joined) >= 15


@settings(deadline=None)
@given(strategies.lists(strategies.integers(0, 2), max_size=60), strategies.integers(1, 9))
def test_a_simulator_that_starts_again_never_mixes_the_two_drives(order, length):
    """However far the first came, and whatever of it was still to be used."""
    first = [lane[:length] for lane in drive()]
    second = [[(kind, stamp, content + 100 if kind == 'image' else content)
               for kind, stamp, content in lane] for lane in drive(episodes=3)]
    joiner = TransitionJoiner()
    feed(joiner, merge(order, first))
    joined = feed(joiner, merge(list(range(3)) * 20, second))
    for transition in joined:
        assert (transition.frame[0, 0, 0] < 100) == (transition.next_frame[0, 0, 0] < 100)
    assert [key(t) for t in joined][-6:] == [
        key(t) for t in feed(TransitionJoiner(), merge(list(range(3)) * 20, second))][-6:]


ODD = strategies.one_of(
    strategies.integers(0, 10**11), strategies.sampled_from([0, 1, 2**31 * 10**9, 2**62]))


def odd_message(kind, stamp):
    return kind, stamp, {
        'image': np.full((2, 2, 3), 255, np.uint8), 'twist': Command(0.9, 0.9),
        'step': read_step({**dict.fromkeys(STEP_CORE, 0.0), 'episode': 77.0, 'decision': 5.0,
                           'applied_sec': 2.0**31 - 1}),
    }[kind]


@settings(deadline=None, max_examples=300)
@given(strategies.lists(strategies.tuples(
    strategies.sampled_from(['image', 'step', 'twist']), ODD, strategies.integers(0, 200)),
    min_size=1, max_size=3))
def test_an_odd_stamp_costs_what_stands_beside_it_and_nothing_later(odd):
    lanes = drive(episodes=4, decisions=16)
    good = merge(list(range(3)) * 100, lanes)
    stamps = {stamp for _, stamp, _ in good}
    odd = [(kind, stamp, place) for kind, stamp, place in odd if stamp not in stamps]
    expected = [key(t) for t in feed(TransitionJoiner(), good)]
    messages = list(good)
    for kind, stamp, place in sorted(odd, key=lambda each: -each[2]):
        messages.insert(place, odd_message(kind, stamp))
    joiner = TransitionJoiner()
    joined = [key(t) for t in feed(joiner, messages)]
    assert set(joined) <= set(expected)
    assert len(joined) >= len(expected) - 5 * len(odd)
    # six decisions after the last odd message everything is as it was
    last = max((place for _, _, place in odd), default=0)
    settled = {stamp for _, stamp, _ in good[last + 18:]}
    assert [k for k in joined if k[0] in settled] == [k for k in expected if k[0] in settled]


@pytest.mark.parametrize('kind', ['image', 'step', 'twist'])
def test_a_stream_of_odd_stamps_holds_nobody_up_and_takes_no_memory(kind):
    lanes = drive(episodes=20, decisions=20)
    good = merge(list(range(3)) * 500, lanes)
    joiner, joined = TransitionJoiner(capacity=200), []
    for number, message in enumerate(good):
        joined += feed(joiner, [odd_message(kind, 2**40 + 7 * number + number % 3), message]
                       if number < 600 else [message])
        assert len(joiner._images) <= 200 and len(joiner._twists) <= 200
        assert len(joiner._images._oldest) <= 600 and len(joiner._twists._oldest) <= 600
    tail = [k for k in (key(t) for t in joined) if k[0] > good[660][1]]
    expected = [key(t) for t in feed(TransitionJoiner(), good) if t.stamp > good[660][1]]
    assert tail == expected and len(tail) > 150


def test_a_step_that_says_that_a_later_twist_was_applied_is_not_waited_for():
    images, steps, twists = drive(episodes=1, decisions=8)
    place, stamp, step = steps[3]
    steps[3] = (place, stamp, dataclasses.replace(step, applied=2**62))
    joiner = TransitionJoiner()
    assert len(feed(joiner, merge(list(range(3)) * 10, (images, steps, twists)))) == 7
    assert joiner.counts['lost_twist'] == 1


def test_twists_with_stamps_of_the_wall_clock_are_joined():
    wall = 1_700_000_000 * 10**9
    images, steps, twists = drive(episodes=1, decisions=8)
    twists = [(kind, wall + stamp, command) for kind, stamp, command in twists]
    steps = [(kind, stamp, step if step.applied is None else
              dataclasses.replace(step, applied=wall + step.applied))
             for kind, stamp, step in steps]
    joiner = TransitionJoiner()
    assert len(feed(joiner, merge([2, 0, 1] * 10, (images, steps, twists)))) == 8


def test_a_pause_of_hours_between_two_frames_is_no_rewind():
    images, steps, twists = drive(episodes=1, decisions=8)

    def later(lane):
        return [(kind, stamp + (10**13 if place > 3 else 0), content)
                for place, (kind, stamp, content) in enumerate(lane)]
    steps = [(kind, stamp, dataclasses.replace(step, applied=step.applied + 10**13)
              if place > 4 else step)
             for place, (kind, stamp, step) in enumerate(later(steps))]
    joiner = TransitionJoiner()
    joined = feed(joiner, merge(list(range(3)) * 10, (later(images), steps, later(twists))))
    assert len(joined) == 8 and not joiner.counts['rewound']


def test_memory_is_bounded_when_a_topic_is_silent():
    joiner = TransitionJoiner(capacity=50)
    for number in range(1000):
        joiner.add_image(number, np.zeros((1, 1, 3), np.uint8))
        joiner.add_step(number, read_step({
            **dict.fromkeys(STEP_CORE, 0.0), 'decision': number,
            'applied_nanosec': max(number - 1, 0)}))
    assert len(joiner._images) <= 50 and len(joiner._steps) <= 50
    # said as what it is: nothing of that topic has ever come
    assert joiner.counts['no_twist'] == 1000 - 50
    assert (joiner.missing, joiner.waiting) == ('cmd_vel', 49)


def test_images_are_bounded_in_bytes():
    joiner = TransitionJoiner(image_bytes=10_000_000)
    frame = np.zeros((640, 480, 3), np.uint8)
    for number in range(100):
        joiner.add_image(number * DECISION, frame)
        assert joiner.held_bytes <= 10_000_000
    assert joiner.held_bytes > 9_000_000
    joiner.add_image(100 * DECISION, np.zeros((2000, 2000, 3), np.uint8))
    assert joiner.held_bytes == 0


def test_it_says_what_it_waits_for():
    images, steps, twists = drive(episodes=1, decisions=8)
    joiner = TransitionJoiner()
    assert joiner.missing == 'step'
    feed(joiner, steps[:4])
    assert (joiner.missing, joiner.waiting) == ('image_raw', 3)
    feed(joiner, images[:3])
    assert (joiner.missing, joiner.waiting) == ('cmd_vel', 3)
    feed(joiner, twists[:8])
    assert (joiner.missing, joiner.waiting) == ('image_raw', 1)
    feed(joiner, images[3:4])
    assert (joiner.missing, joiner.waiting) == ('', 0)


@pytest.mark.parametrize('capacity', [3, 1000])
def test_what_waited_for_images_that_never_came_is_counted_as_what_it_is(capacity):
    images, steps, twists = drive(episodes=3)
    joiner = TransitionJoiner(capacity=capacity)
    # one by one, so that what is kept of the twists is not the limit
    for step, twist, image in itertools.zip_longest(steps, twists, images[:5]):
        feed(joiner, [one for one in (image, twist, step) if one])
    joiner.end()
    # four of each episode, and nothing between the last frame of one and the first of the next
    assert joiner.counts == {'joined': 4, 'lost_image': 8}
