# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The environment: its interface, its variants, its facts, and what it refuses."""

from pathlib import Path

import gymnasium
from gymnasium.envs.box2d.car_racing import CarRacing
import numpy as np
import pytest

from carracing_dqn.benchmarks.driver import Driver
from carracing_sim_node import EpisodeError
from carracing_sim_node import InvalidActionError
from carracing_sim_node import InvalidVariantError
from carracing_sim_node import SimulatorError
from carracing_sim_node import guard
from carracing_sim_node import make_env
from carracing_sim_node.progress import PASSED_BEHIND
from carracing_sim_node.progress import TileProgress
from carracing_sim_node.track_layout import lay_track

STILL = np.zeros(3, np.float32)
GAS = np.array([0.0, 0.8, 0.0], np.float32)


@pytest.fixture
def env():
    return make_env()


def undrawn(stock):
    """Let a stock environment step without its slow drawing."""
    stock._render = lambda mode: None
    return stock


def test_the_spaces_are_gymnasiums():
    stock = gymnasium.make('CarRacing-v3')
    env = make_env()
    assert env.action_space == stock.action_space
    assert env.observation_space == stock.observation_space
    discrete = gymnasium.make('CarRacing-v3', continuous=False)
    assert make_env(continuous=False).action_space == discrete.action_space


@pytest.mark.parametrize('style', ['lap', 'fast', 'random', 'spin', 'away'])
def test_physics_reward_and_ends_equal_gymnasiums_over_whole_episodes(env, style):
    stock = undrawn(CarRacing())
    stock.reset(seed=21)
    env.reset(seed=21)
    driver = Driver(env, style, 21)
    terminated = truncated = False
    while not terminated and not truncated:
        action = driver.act()
        _, reward, terminated, truncated, info = env.step(action, draw=False)
        _, stock_reward, stock_terminated, _, stock_info = stock.step(action)
        assert (reward, terminated, info) == (stock_reward, stock_terminated, stock_info)
        ours, theirs = env.simulation.car, stock.car
        assert tuple(ours.hull.position) == tuple(theirs.hull.position)
        assert ours.hull.angle == theirs.hull.angle
        for wheel, other in zip(ours.wheels, theirs.wheels):
            assert (wheel.omega, wheel.phase) == (other.omega, other.phase)
            assert len(wheel.tiles) == len(other.tiles)
    assert len(ours.particles) == len(theirs.particles)
    colours = [tuple(colour) for _, colour in env.simulation.road_poly]
    assert colours == [tuple(colour) for _, colour in stock.road_poly]


def test_discrete_actions_equal_gymnasiums():
    env = make_env(continuous=False)
    stock = undrawn(CarRacing(continuous=False))
    env.reset(seed=5)
    stock.reset(seed=5)
    for frame in range(200):
        action = (3, 3, 1, 2, 0, 4)[frame // 9 % 6]
        assert env.step(action, draw=False)[1] == stock.step(action)[1]
        assert env.simulation.car.hull.angle == stock.car.hull.angle


def test_an_action_repeat_is_the_sum_of_its_frames():
    single = make_env()
    group = make_env(action_repeat=5)
    single.reset(seed=9)
    group.reset(seed=9)
    for turn in range(20):
        action = np.array([0.2 * (turn % 3 - 1), 0.7, 0.0], np.float32)
        frames = [single.step(action) for _ in range(5)]
        frame, reward, terminated, truncated, info = group.step(action)
        assert np.array_equal(frame, frames[-1][0])
        assert reward == sum(step[1] for step in frames)
        assert (terminated, truncated, info) == (False, False, {'frames': 5})
    assert group.facts() == single.facts()


def test_a_group_stops_at_the_frame_that_ends_the_episode():
    env = make_env(action_repeat=8, max_episode_steps=20)
    env.reset(seed=1)
    infos = [env.step(GAS, draw=False) for _ in range(3)]
    assert [step[4]['frames'] for step in infos] == [8, 8, 4]
    assert [step[3] for step in infos] == [False, False, True]
    assert env.facts().frames == 20


def test_the_time_limit_truncates_as_gymnasiums_does():
    env = make_env()
    env.reset(seed=1)
    ends = [env.step(STILL, draw=False)[2:] for _ in range(1000)]
    assert ends[:999] == [(False, False, {})] * 999
    assert ends[999] == (False, True, {})
    endless = make_env(max_episode_steps=None)
    endless.reset(seed=1)
    assert not any(endless.step(STILL, draw=False)[3] for _ in range(1100))


def test_the_first_step_is_paid_for_the_tiles_under_the_car(env):
    env.reset(seed=4)
    tiles = env.facts()
    assert tiles.tiles_visited > 0
    reward = env.step(STILL, draw=False)[1]
    assert reward == pytest.approx(1000 * tiles.tiles_visited / tiles.tiles_total - 0.1)


def test_an_early_end_truncates_after_frames_without_a_new_tile():
    env = make_env(early_end_frames=30, action_repeat=4)
    env.reset(seed=2)
    ended = False
    while not ended:
        before = env.facts()
        _, _, terminated, ended, info = env.step(STILL, draw=False)
        assert not terminated
    assert info == {'ended_early': True, 'frames': 2}
    assert before.frames == 28 and not before.ended_early
    assert env.facts().frames == 30 and env.facts().ended_early


def test_an_early_end_waits_while_new_tiles_are_found():
    env = make_env(early_end_frames=60, max_episode_steps=400)
    env.reset(seed=3)
    driver = Driver(env, 'lap')
    ends = [env.step(driver.act(), draw=False)[3] for _ in range(400)]
    assert ends.index(True) == 399
    assert not env.facts().ended_early


def test_a_finished_lap_never_counts_as_an_early_end():
    env = make_env(early_end_frames=200)
    env.reset(seed=8)
    driver = Driver(env, 'lap')
    terminated = truncated = False
    while not terminated and not truncated:
        _, _, terminated, truncated, info = env.step(driver.act(), draw=False)
    assert (terminated, truncated, info) == (True, False, {'lap_finished': True})
    facts = env.facts()
    assert facts.lap_finished and not facts.ended_early
    assert facts.tiles_visited == facts.tiles_total and facts.tiles_missed == 0


def test_the_lap_variant_ends_where_the_car_has_come_round():
    env = make_env(early_end_lap=True)
    env.reset(seed=8)
    progress = env._sim.contacts.progress
    # as if the car had passed by a tile without a wheel on it
    driver = Driver(env, 'lap')
    env._sim.road[40].road_visited = True
    terminated = truncated = False
    while not terminated and not truncated:
        _, _, terminated, truncated, info = env.step(driver.act(), draw=False)
    facts = env.facts()
    assert (terminated, truncated, info) == (False, True, {'ended_early': True})
    assert facts.came_round and facts.ended_early and not facts.lap_finished
    assert facts.tiles_visited == facts.tiles_total - 1
    assert progress.head == facts.tiles_total + PASSED_BEHIND - 1


def test_skipped_drawing_returns_no_frame_and_changes_nothing_else():
    drawn, blind = make_env(), make_env()
    drawn.reset(seed=6)
    blind.reset(seed=6)
    for _ in range(10):
        seen = drawn.step(GAS)
        unseen = blind.step(GAS, draw=False)
        assert unseen[0] is None
        assert seen[1:] == unseen[1:]
    assert np.array_equal(seen[0], blind.draw())


@pytest.mark.parametrize(('randomize', 'renderer'), [
    (False, 'auto'), (True, 'auto'), (True, 'stock')])
def test_skipped_episodes_leave_the_generator_where_resets_would(randomize, renderer):
    skipping = make_env(domain_randomize=randomize, renderer=renderer)
    resetting = make_env(domain_randomize=randomize)
    # in the middle of an episode, whose bodies have to leave the world all the same
    skipping.reset(seed=3)
    skipping.skip_episodes(7, seed=12)
    resetting.reset(seed=12)
    for _ in range(6):
        resetting.reset()
    for _ in range(2):
        assert np.array_equal(skipping.reset()[0], resetting.reset()[0])
        assert skipping.simulation.track == resetting.simulation.track
        assert skipping.simulation.world.bodyCount == resetting.simulation.world.bodyCount
        skipping.skip_episodes(1)
        resetting.reset()


def test_tracks_equal_gymnasiums_to_the_last_bit():
    assert guard.compare_tracks(120) == ''


def test_a_track_whose_ends_do_not_meet_uses_the_same_random_numbers():
    stock = undrawn(CarRacing())
    ours = make_env().simulation
    failed = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        failed += lay_track(rng) is None
        stock.reset(seed=seed)
        ours.reset(seed=seed)
        assert stock.np_random.bit_generator.state == ours.np_random.bit_generator.state
        assert stock.start_alpha == ours.start_alpha
    assert failed, 'every track closed at the first try, so no second one was tried'


@pytest.mark.parametrize('style', ['lap', 'spin', 'away'])
def test_a_world_that_was_driven_in_before_gives_the_same_lap(env, style):
    def lap(env):
        seen = [env.reset(seed=23)[0]]
        driver = Driver(env, style, 23)
        rewards, ended = [], False
        while not ended:
            seen[0], *rest = env.step(driver.act(), draw=len(rewards) % 50 == 0)
            rewards.append(rest[0])
            if seen[0] is not None:
                seen.append(seen[0])
            ended = rest[1] or rest[2]
        return seen[1:], rewards, env.facts()

    env.reset(seed=1)
    for _ in range(100):
        env.step(GAS, draw=False)
    frames, *used = lap(env)
    fresh, *expected = lap(make_env())
    assert used == expected
    assert all(np.array_equal(one, other) for one, other in zip(frames, fresh))


def test_the_physics_is_no_second_environment(env):
    env.reset(seed=1)
    with pytest.raises(InvalidActionError, match=r'driven by advance'):
        env.simulation.step(GAS)
    assert env.facts().frames == 0


def test_skipping_ends_the_episode(env):
    env.reset(seed=1)
    env.skip_episodes(0)
    with pytest.raises(EpisodeError):
        env.step(GAS)


def test_seeds_give_the_same_lap_twice():
    first, second = make_env(), make_env()
    rng = np.random.default_rng(0)
    for _ in range(2):
        assert np.array_equal(first.reset(seed=33)[0], second.reset(seed=33)[0])
        for _ in range(20):
            action = rng.uniform((-1, 0, 0), 1).astype(np.float32)
            one, two = first.step(action), second.step(action)
            assert np.array_equal(one[0], two[0])
            assert one[1:] == two[1:]


def test_the_rendered_picture_is_gymnasiums(env):
    stock = CarRacing(render_mode='rgb_array')
    env.reset(seed=14)
    stock.reset(seed=14)
    for _ in range(3):
        env.step(GAS)
        stock.step(GAS)
    assert np.array_equal(env.render(), stock.render())


def test_facts_follow_the_car_off_the_road_and_to_rest(env):
    env.reset(seed=7)
    start = env.facts()
    assert start.frames == 0 and start.wheels_off_road == 0.0
    for _ in range(120):
        env.step(np.array([1.0, 0.6, 0.0], np.float32), draw=False)
    off = env.facts()
    assert off.wheels_off_road == 1.0
    assert off.standing_still == 0
    velocity = env.simulation.car.hull.linearVelocity
    assert off.speed == pytest.approx(np.hypot(velocity[0], velocity[1]))
    for _ in range(150):
        env.step(np.array([0.0, 0.0, 1.0], np.float32), draw=False)
    rest = env.facts()
    assert rest.speed < 1.0
    assert rest.standing_still > 20
    assert rest.frames == 270


def test_a_shortcut_leaves_tiles_behind(env):
    env.reset(seed=7)
    sim = env.simulation
    for tile in (10, 30):
        x, y = sim.track[tile][2:4]
        for body in (sim.car.hull, *sim.car.wheels):
            body.position = (x, y)
        env.step(STILL, draw=False)
        env.step(STILL, draw=False)
    facts = env.facts()
    missed = sim.contacts.progress.missed_tiles
    assert facts.tiles_missed == len(missed)
    assert missed >= set(range(14, 27))
    # Nothing that is still within reach, or ahead.
    assert max(missed) < 30


def test_progress_counts_what_lies_behind_and_forgives_what_is_fetched():
    progress = TileProgress(100)
    for tile in (0, 99, 1, 2, 6, 7):
        progress.touch(tile)
    assert progress.missed_tiles == {3, 4}
    progress.touch(10)
    assert progress.missed_tiles == {3, 4, 5}
    progress.touch(4)
    assert progress.missed_tiles == {3, 5}
    assert progress.head == 10


def test_progress_does_not_count_reversing_from_the_start():
    progress = TileProgress(100)
    for tile in (0, 99, 98, 97, 60, 40, 20):
        progress.touch(tile)
    assert progress.missed == 0
    assert progress.head == 0


def test_the_place_is_the_foremost_tile_under_a_wheel_in_any_order():
    progress = TileProgress(100)
    for under_wheels, place in (
            ([98, 99, 0], 0), ([3, 5, 4], 5), ([], 5), ([3, 4], 4), ([99], -1), ([97], -3),
            ([30], 30), ([70], 70), ([99, 1], 101)):
        progress.locate(under_wheels)
        assert progress.place == place
    progress.touch(7)
    assert progress.stale and progress.place == 101


def test_progress_at_the_end_of_a_lap_and_beyond():
    progress = TileProgress(50)
    for tile in range(50):
        if tile != 30:
            progress.touch(tile)
    assert progress.missed_tiles == {30} and not progress.came_round
    for tile in range(10):
        progress.touch(tile)
    assert progress.missed_tiles == {30}
    assert progress.head == 59 and progress.came_round
    late = TileProgress(50)
    for tile in (*range(48), 0, 1, 2):
        late.touch(tile)
    assert late.missed_tiles == {48, 49} and late.came_round
    assert PASSED_BEHIND == 3


@pytest.mark.parametrize(
    'action',
    [
        np.array([1.01, 0.0, 0.0]),
        np.array([-1.01, 0.0, 0.0]),
        np.array([0.0, -0.1, 0.0]),
        np.array([0.0, 1.1, 0.0]),
        np.array([0.0, 0.0, 2.0]),
        np.array([np.nan, 0.0, 0.0]),
        np.array([0.0, np.inf, 0.0]),
        np.zeros(2),
        np.zeros((3, 1)),
        np.float32(0.5),
        None,
        'gas',
        [0.0, 0.0, 'x'],
        3,
    ],
)
def test_a_bad_action_is_refused_and_changes_nothing(env, action):
    env.reset(seed=1)
    with pytest.raises(InvalidActionError, match=r'expected three numbers'):
        env.step(action)
    assert env.facts().frames == 0
    assert env.step(GAS)[0].shape == (96, 96, 3)


@pytest.mark.parametrize('action', [5, -1, 1.5, None, np.zeros(3)])
def test_a_bad_discrete_action_is_refused(action):
    env = make_env(continuous=False)
    env.reset(seed=1)
    with pytest.raises(InvalidActionError, match='from 0 to 4'):
        env.step(action)
    assert env.step(np.int64(3), draw=False)[4] == {}


@pytest.mark.parametrize(
    ('name', 'value', 'expected'),
    [
        ('action_repeat', 0, 'at least 1'),
        ('action_repeat', 2.0, 'whole number'),
        ('action_repeat', True, 'whole number'),
        ('early_end_frames', -1, 'at least 0'),
        ('max_episode_steps', 0, 'at least 1'),
        ('zoom', 'no', 'True or False'),
        ('domain_randomize', 1, 'True or False'),
        ('continuous', None, 'True or False'),
        ('renderer', 'opengl', 'auto, fast, stock'),
    ],
)
def test_an_unknown_variant_is_refused_by_name(name, value, expected):
    with pytest.raises(InvalidVariantError, match=expected) as caught:
        make_env(**{name: value})
    assert name in str(caught.value)
    assert isinstance(caught.value, SimulatorError)


def test_frames_before_reset_and_after_the_end_are_refused():
    env = make_env(max_episode_steps=2)
    for ask in (lambda: env.step(GAS), env.draw, env.render, env.facts):
        with pytest.raises(EpisodeError, match='reset'):
            ask()
    env.reset(seed=1)
    env.step(GAS)
    env.step(GAS)
    with pytest.raises(EpisodeError, match='over'):
        env.step(GAS)
    assert env.facts().frames == 2
    env.reset()
    assert env.step(GAS)[3] is False


def test_it_stands_gymnasiums_own_checker():
    from gymnasium.utils.env_checker import check_env

    check_env(make_env(), skip_render_check=True)


@pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='reads the memory from /proc')
def test_memory_is_flat_over_resets(env):
    def pages():
        return int(Path('/proc/self/statm').read_text().split()[1])

    env.reset(seed=0)
    for _ in range(60):
        env.reset()
    start = pages()
    for _ in range(150):
        env.reset()
        env.step(GAS, draw=False)
    # One episode's bodies are about a tenth of a megabyte: 150 leaked ones would be 15 MB.
    assert (pages() - start) * 4096 < 3e6
