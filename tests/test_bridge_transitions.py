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

DECISION = 80_000_000


def drive(episodes=2, decisions=4):
    """Return the (kind, stamp, content) messages of a lockstep drive, topic by topic."""
    images, steps, twists = [], [], []
    stamp = 0
    for episode in range(episodes):
        stamp += 1_000_000_000
        for decision in range(decisions + 1):
            applied = (-1, 0) if decision == 0 else divmod(stamp - DECISION, 10**9)
            images.append(('image', stamp, np.full((2, 2, 3), len(images), np.uint8)))
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


def test_an_unanswered_frame_is_no_transition():
    images, steps, twists = drive(episodes=1)
    steps[2] = ('step', steps[2][1], dataclasses.replace(steps[2][2], applied=None))
    joiner = TransitionJoiner()
    assert len(feed(joiner, merge(list(range(3)) * 10, (images, steps, twists)))) == 3
    assert joiner.counts['unanswered'] == 1


def test_time_that_goes_back_joins_nothing_across_the_break():
    messages = merge(list(range(3)) * 10, drive())
    joiner = TransitionJoiner()
    joined = feed(joiner, messages + messages)
    assert joiner.counts['rewound'] == 1
    assert all(0 < t.next_stamp - t.stamp == DECISION for t in joined)
    assert len(joined) >= 15


def test_memory_is_bounded_when_a_topic_is_silent():
    joiner = TransitionJoiner(capacity=50)
    for number in range(1000):
        joiner.add_image(number, np.zeros((1, 1, 3), np.uint8))
        joiner.add_step(number, read_step({
            **dict.fromkeys(STEP_CORE, 0.0), 'decision': number,
            'applied_nanosec': max(number - 1, 0)}))
    assert len(joiner._images.items) <= 50 and len(joiner._steps) <= 50
