# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The replay buffer, against a plain list of episodes."""
from hypothesis import given, settings, strategies
from msgs_bridge.errors import SettingsError
import numpy as np
import pytest
from trainer_node.augmentation import augment
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.replay_buffer import ReplayBuffer
from trainer_node.stack_gather import gather_stacks

GAMMA = 0.5


def observation(level):
    # two bytes, so that every observation of a test can be told apart
    return np.array([[level % 256, level // 256]], np.uint8)


def level(pixels):
    return int(pixels[..., 0, 0]) + 256 * int(pixels[..., 0, 1])


def fill(buffer, segments):
    """Fill with segments (length, how it ends); return what each observation led to."""
    truth, number = {}, 0
    for length, end in segments:
        first = number
        buffer.start(observation(number))
        for step in range(length):
            reward = float(number + 1)
            terminated = end == 'terminated' and step == length - 1
            buffer.add(number % 5, reward, observation(number + 1), terminated=terminated)
            truth[number] = (first, first + length, reward, terminated)
            number += 1
        number += 1
    return truth


def expected(truth, start, n_steps):
    """Return rewards, discount and the observation after up to n steps, by walking."""
    _, last, _, _ = truth[start]
    total, discount, place = 0.0, 1.0, start
    for _ in range(n_steps):
        if place == last:
            break
        _, _, reward, terminated = truth[place]
        total += discount * reward
        discount *= GAMMA
        place += 1
        if terminated:
            return total, 0.0, place
    return total, discount, place


@settings(max_examples=60, deadline=None)
@given(
    segments=strategies.lists(strategies.tuples(
        strategies.integers(1, 9), strategies.sampled_from(['terminated', 'truncated', 'broken'])),
        min_size=1, max_size=12),
    capacity=strategies.integers(8, 60), frame_stack=strategies.integers(1, 4),
    n_steps=strategies.integers(1, 4))
def test_no_sample_crosses_a_boundary(segments, capacity, frame_stack, n_steps):
    buffer = ReplayBuffer(
        capacity, (1, 2), frame_stack=frame_stack, n_steps=n_steps, gamma=GAMMA)
    truth = fill(buffer, segments)
    held = len(buffer)
    assert held == min(sum(length + 1 for length, _ in segments), capacity)
    try:
        batch = buffer.sample(64, np.random.default_rng(0))
    except ValueError:
        # so small that no whole stack with an action is left
        assert capacity <= frame_stack + 9
        return
    for index in range(64):
        stack = [level(pixels) for pixels in batch.observations[index]]
        number = stack[-1]
        first = truth[number][0]
        assert stack == [max(number - back, first) for back in range(frame_stack - 1, -1, -1)]
        assert batch.actions[index] == number % 5
        rewards, discount, after = expected(truth, number, n_steps)
        assert batch.rewards[index] == pytest.approx(rewards)
        assert batch.discounts[index] == pytest.approx(discount)
        next_stack = [level(pixels) for pixels in batch.next_observations[index]]
        assert next_stack == [max(after - back, first) for back in range(frame_stack - 1, -1, -1)]


def test_every_held_transition_is_drawn_about_as_often():
    buffer = ReplayBuffer(50, (1, 2), frame_stack=2)
    truth = fill(buffer, [(7, 'terminated')] * 20)
    random = np.random.default_rng(1)
    counts = {}
    for _ in range(100):
        for pixels in buffer.sample(64, random).observations[:, -1]:
            counts[level(pixels)] = counts.get(level(pixels), 0) + 1
    newest = max(truth) + 1
    held = [number for number in truth if number > newest - 50 + 1]
    assert sorted(counts) == held
    assert max(counts.values()) < 1.6 * min(counts.values())


def test_each_observation_is_stored_once():
    buffer = ReplayBuffer(100, (1, 2), frame_stack=4)
    fill(buffer, [(9, 'truncated')] * 5)
    assert len(buffer) == 50
    assert buffer.transitions == 45


def test_an_empty_buffer_says_so():
    buffer = ReplayBuffer(10, (1, 2))
    with pytest.raises(ValueError, match='holds no transition'):
        buffer.sample(1, np.random.default_rng(0))
    for _ in range(5):
        buffer.start(observation(0))
    with pytest.raises(ValueError, match='holds no transition'):
        buffer.sample(1, np.random.default_rng(0))


def test_a_lone_transition_among_broken_segments_is_found():
    buffer = ReplayBuffer(5000, (1, 2))
    for _ in range(4000):
        buffer.start(observation(3))
    buffer.add(2, 1.0, observation(4), terminated=False)
    buffer.start(observation(3))
    assert set(buffer.sample(8, np.random.default_rng(0)).actions) == {2}


@pytest.mark.parametrize('stack', [1, 2, 4, 5])
def test_stacks_are_read_in_order_and_channels_last(stack):
    random = np.random.default_rng(0)
    observations = random.integers(0, 256, (30, 9, 7), np.uint8)
    slots = random.integers(0, 30, (6, stack))
    out = np.empty((6, 9, 7, stack), np.uint8)
    gather_stacks(observations, slots, out)
    assert np.array_equal(out.transpose(0, 3, 1, 2), observations[slots])


def augmented(count, **settings):
    """Return a batch of one transition from (10, 20) to (30, 200), many times, augmented."""
    buffer = ReplayBuffer(100, (1, 2))
    buffer.start(np.array([[10, 20]], np.uint8))
    buffer.add(1, 1.0, np.array([[30, 200]], np.uint8), terminated=False)
    random = np.random.default_rng(0)
    return augment(buffer.sample(count, random), Hyperparameters(**settings), random)


def test_flips_mirror_observations_and_actions_together():
    batch = augmented(200, flips=True)
    # of the five of the report 1 and 2 are left and right
    flipped = batch.actions == 2
    assert 60 < flipped.sum() < 140 and (batch.actions[~flipped] == 1).all()
    for index in range(200):
        expected_pair = ([[20, 10]], [[200, 30]]) if flipped[index] else ([[10, 20]], [[30, 200]])
        assert batch.observations[index, 0].tolist() == expected_pair[0]
        assert batch.next_observations[index, 0].tolist() == expected_pair[1]


def test_brightness_is_one_factor_for_both_observations_of_a_sample():
    batch = augmented(500, brightness=0.4)
    before, after = batch.observations[:, 0, 0], batch.next_observations[:, 0, 0]
    factors = after[:, 0] / 30
    assert factors.min() < 0.65 and factors.max() > 1.35 and len(np.unique(factors)) > 15
    for column, level in ((before[:, 0], 10), (before[:, 1], 20)):
        assert np.abs(column - level * factors).max() <= 1
    assert np.abs(after[:, 1] - np.minimum(200 * factors, 255)).max() <= 4
    assert after[:, 1].max() == 255
    assert (batch.actions == 1).all()


def test_brightness_does_not_go_with_a_road_that_is_known_by_its_levels():
    with pytest.raises(SettingsError, match='road: contrast reads exact levels'):
        Hyperparameters(brightness=0.1, road='contrast')


def test_a_restored_buffer_samples_the_same():
    buffer, other = (ReplayBuffer(30, (1, 2), frame_stack=3, n_steps=2) for _ in range(2))
    fill(buffer, [(7, 'terminated'), (5, 'broken'), (9, 'truncated'), (9, 'broken')])
    arrays = {name: array.copy() for name, array in buffer.state_arrays().items()}
    other.load_state(arrays, buffer.written)
    other.put_observations(buffer.oldest, buffer.observations(buffer.oldest, buffer.written))
    for own in (buffer, other):
        own.add(1, 5.0, observation(999), terminated=False)
    first = buffer.sample(40, np.random.default_rng(0))
    second = other.sample(40, np.random.default_rng(0))
    assert all(np.array_equal(a, b) for a, b in zip(first, second))
    with pytest.raises(ValueError, match='replay observations are'):
        ReplayBuffer(30, (2, 2)).put_observations(0, buffer.observations(0, 10))


def interleave(buffer, sources, count, seed, truth):
    """Let sources add by turns drawn at random; note each transition by what tells it apart."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        source = int(random.integers(len(sources)))
        segment = sources[source]
        if not segment or not buffer.can_add(source) or random.random() < 0.1:
            segment[:] = [len(truth)]
            truth[segment[0]] = None
            buffer.start(observation(segment[0]), source)
        number, reward = len(truth), float(random.integers(100))
        buffer.add(source, reward, observation(number), terminated=False, source=source)
        truth[segment[-1]] = (tuple(segment), source, reward, number)
        truth[number] = None
        segment.append(number)


@pytest.mark.parametrize('capacity', [40, 90, 400])
@pytest.mark.parametrize('frame_stack', [1, 3, 4])
@pytest.mark.parametrize('n_steps', [1, 3])
def test_nothing_is_drawn_across_sources(capacity, frame_stack, n_steps):
    buffer = ReplayBuffer(capacity, (1, 2), frame_stack=frame_stack, n_steps=n_steps, gamma=GAMMA)
    truth, sources = {}, [[], [], []]
    seen = set()
    for seed in range(12):
        interleave(buffer, sources, 30, seed, truth)
        batch = buffer.sample(64, np.random.default_rng(seed))
        for index in range(64):
            stack = [level(pixels) for pixels in batch.observations[index]]
            segment, source, reward, after = truth[stack[-1]]
            whole = [segment[0]] * frame_stack + list(segment)
            assert stack == whole[-frame_stack:]
            assert batch.actions[index] == source
            total, place, discount = 0.0, stack[-1], 1.0
            for _ in range(n_steps):
                if truth[place] is None:
                    break
                total += discount * truth[place][2]
                discount *= GAMMA
                segment, place = truth[place][0], truth[place][3]
            assert batch.rewards[index] == pytest.approx(total)
            assert batch.discounts[index] == pytest.approx(discount)
            whole = [segment[0]] * frame_stack + [*segment, place]
            assert [level(pixels) for pixels in batch.next_observations[index]] == (
                whole[-frame_stack:])
            seen.add(source)
    assert seen == {0, 1, 2}


def test_sources_are_drawn_in_proportion_to_what_they_sent():
    buffer = ReplayBuffer(1000, (1, 2), frame_stack=2)
    for source in (0, 1):
        buffer.start(observation(source), source)
    for number in range(2000):
        # one sends three times as often
        source = int(number % 4 == 0)
        buffer.add(source, 0.0, observation(number % 50_000), terminated=False, source=source)
    actions = buffer.sample(4000, np.random.default_rng(0)).actions
    assert 0.22 < actions.mean() < 0.28


@pytest.mark.parametrize('count', [20, 300])
def test_a_restored_buffer_of_several_sources_samples_the_same(count):
    buffer, other = (ReplayBuffer(80, (1, 2), frame_stack=3, n_steps=2) for _ in range(2))
    truth, sources = {}, [[], [], []]
    interleave(buffer, sources, count, 0, truth)
    arrays = {name: array.copy() for name, array in buffer.state_arrays().items()}
    other.load_state(arrays, buffer.written)
    other.put_observations(buffer.oldest, buffer.observations(buffer.oldest, buffer.written))
    for round_ in range(6):
        batches = [own.sample(200, np.random.default_rng(round_)) for own in (buffer, other)]
        assert all(np.array_equal(a, b) for a, b in zip(*batches))
        for own in (buffer, other):
            interleave(own, [list(segment) for segment in sources], 10, round_, dict(truth))
    assert [own.can_add(number) for own in (buffer, other) for number in range(4)] == 2 * [
        buffer.can_add(number) for number in range(4)]


def test_a_source_that_was_away_while_all_of_it_was_overwritten_begins_anew():
    buffer = ReplayBuffer(10, (1, 2))
    assert not buffer.can_add(0)
    for source in (0, 1):
        buffer.start(observation(source), source)
    for number in range(9):
        assert buffer.can_add(0) == (number < 8)
        buffer.add(0, 0.0, observation(number), terminated=False, source=1)
