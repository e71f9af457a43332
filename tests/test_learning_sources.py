# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Sources: which are meant, taken from by turns, bounded, refused and counted."""
import itertools
import sys
import threading

from learning_cases import COMMANDS, make_step
from msgs_bridge.errors import SettingsError
from msgs_bridge.seeds import (
    epsilon_exponent, EPISODES_OF_A_CAR, is_validation, MAX_CARS, TRAINING, training_seed,
)
import numpy as np
import pytest
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.source import LOSSES, MAX_WAITING_BYTES, OVERRUN, SHARE, Source
from trainer_node.sources import SourceNames, Sources

FRAME = np.zeros((96, 96, 3), np.uint8)
FIRST = 10**9
DECISION = 80_000_000


def feed(source, count, first=0, frame=FRAME):
    """Let a source join `count` transitions."""
    for number in range(first, first + count + 1):
        stamp = FIRST + number * DECISION
        source.add_image(stamp, frame)
        source.add_twist(stamp, COMMANDS[0])
        source.add_step(stamp, make_step(
            decision=number, applied_sec=(stamp - DECISION) // 10**9,
            applied_nanosec=(stamp - DECISION) % 10**9))
    source.looked()


@pytest.mark.parametrize('text', [
    '/car 1', '/1car', '//', '/', 'a' * 300, 'car_*,-', 'a,,b', 'a' * 190 + '!', '/a/', ','])
def test_what_is_no_namespace_is_named(text):
    with pytest.raises(SettingsError, match='sources has .*; accepted: namespaces such as'):
        SourceNames(text, '/')


@pytest.mark.parametrize(('text', 'given', 'matching'), [
    ('', (), []), (' ', (), []),
    ('/car_*', (), ['/car_1', '/car_22']),
    ('car_*', (), []),
    ('/car_?, /truck', ('/truck',), ['/car_1']),
    ('/*/car', (), ['/there/car']),
    ('/*', (), ['/car_1', '/car_22', '/scar_1'])])
def test_names_and_patterns(text, given, matching):
    names = SourceNames(text, '/space')
    found = ['/car_22', '/car_1', '/scar_1', '/there/car', '/a/b/car_1', '/car_1']
    assert (names.given, names.matching(found)) == (given, matching)
    assert bool(names) == bool(text.strip())
    assert SourceNames('car_*', '/space').matching(['/space/car_3', '/car_3']) == ['/space/car_3']


def test_a_car_that_is_named_twice_is_learned_from_once():
    assert SourceNames('/car_1, car_1,/car_1,/car_2', '/').given == ('/car_1', '/car_2')
    with pytest.raises(SettingsError, match='sources has 129 names; accepted: up to 128'):
        SourceNames(','.join(f'/car_{number}' for number in range(129)), '/')


def test_they_are_taken_from_by_turns_and_held_back_together():
    sources = Sources(queue_limit=8)
    assert sources.take() is None
    many, few = sources.add('/many'), sources.add('/few')
    feed(many, 6)
    feed(few, 2)
    assert not sources.should_hold(False)
    feed(few, 1, first=3)
    assert sources.should_hold(False)
    names = [sources.take()[1] for _ in range(7)]
    assert sorted(names[:4]) == ['/few', '/few', '/many', '/many']
    assert sources.should_hold(True) == (len(many) + len(few) > 2)
    sources.remove(many)
    assert sources.all == (few,) and not sources.should_hold(True)


def test_what_one_of_several_may_keep_is_bounded_in_bytes():
    source = Sources(queue_limit=10_000).add('/car')
    large = np.zeros((1000, 1000, 3), np.uint8)
    feed(source, 20, frame=large)
    assert len(source) * large.nbytes <= MAX_WAITING_BYTES // SHARE + large.nbytes
    assert source.overrun == source.lost > 0
    small = Sources(queue_limit=1).add('/car')
    feed(small, OVERRUN + 10)
    assert len(small) == OVERRUN and small.overrun == 10


def test_what_is_refused_is_counted_and_nothing_of_it_is_joined_later():
    source = Sources(queue_limit=64).add('/car')
    feed(source, 5)
    source.refuse('two of one name')
    assert len(source) == 0 and source.dropped == source.lost == 5
    feed(source, 3, first=6)
    source.refuse('two of one name')
    source.accept()
    assert source.dropped == 9 and source.joiner.waiting == 0 and not source.refused
    feed(source, 4, first=20)
    assert [source.take().step.decision for _ in range(4)] == [21, 22, 23, 24]
    assert source.joiner.counts['joined'] == 13 and not {*LOSSES} & {*source.joiner.counts}
    assert source.rate() > 0 and source.lag >= 0


def test_no_two_cars_and_no_validation_meet_in_a_seed():
    settings = [Hyperparameters(seed=seed, seed_each_episode=each, validation_seed=2**20)
                for seed in (0, 42, 2**31 - 1) for each in (False, True)]
    for one in settings:
        firsts = [one.simulator_parameters(car)['seed'] for car in range(MAX_CARS)]
        assert all(one.simulator_parameters(car)['seed_each_episode'] for car in (0, 7))
        # each may drive so many episodes before it comes to the first of another
        assert min(np.diff(sorted(firsts))) >= EPISODES_OF_A_CAR
        assert min(firsts) >= TRAINING and not is_validation(min(firsts), 1)
        assert max(firsts) + EPISODES_OF_A_CAR < 2**31
    # one car alone drives as it always did
    assert Hyperparameters().simulator_parameters()['seed'] == 42
    assert settings[1].simulator_parameters()['seed'] == training_seed(0)


def test_epsilon_is_spread_as_in_ape_x():
    assert [epsilon_exponent(car, 8, 7.0) for car in (0, 1, 7)] == [1.0, 2.0, 8.0]
    assert epsilon_exponent(0, 1, 7.0) == 1.0
    assert epsilon_exponent(9, 4, 7.0) == 8.0
    assert epsilon_exponent(3, 4, 0.0) == 1.0


def test_figures_are_read_while_the_learning_thread_counts():
    source, stop = Source(64), threading.Event()

    def count():
        for number in itertools.cycle(range(5000)):
            source.joiner.counts[f'reason_{number}'] += 1
            if number == 0:
                source.joiner.counts.clear()
            if stop.is_set():
                return

    interval = sys.getswitchinterval()
    # so that the other thread has a turn within every loop
    sys.setswitchinterval(1e-6)
    counting = threading.Thread(target=count)
    counting.start()
    try:
        for _ in range(200):
            assert source.figures().keys() >= {'waiting'}
            assert source.lost >= 0 and isinstance(source.losses(), str)
    finally:
        stop.set()
        counting.join()
        sys.setswitchinterval(interval)
