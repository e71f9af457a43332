# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The fast renderer against pygame and gymnasium, byte for byte."""

import subprocess
import sys

from gymnasium.envs.box2d.car_racing import CarRacing
import numpy as np
import pygame
from pygame import gfxdraw
import pytest

from carracing_dqn.benchmarks.driver import Driver
from carracing_dqn.benchmarks.fidelity import compare
from carracing_sim_node import guard
from carracing_sim_node import make_env
from carracing_sim_node import scanline
from carracing_sim_node.car_shape import place_polygons
from carracing_sim_node.edges import MAX_CORNERS
from carracing_sim_node.fast_renderer import rotation
from carracing_sim_node.panel import BAR_COLOURS
from carracing_sim_node.panel import NO_BAR
from carracing_sim_node.shrink_filter import shrink_tables

UNTURNED = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 500.0, 400.0])


def shrunk(surface):
    """Return what gymnasium makes of its surface."""
    small = pygame.transform.smoothscale(surface, (96, 96))
    return pygame.surfarray.array3d(small).transpose(1, 0, 2)


def rgb_of(packed):
    return (int(packed) >> 16, int(packed) >> 8 & 255, int(packed) & 255)


def with_panel(surface):
    """Turn the surface over and cover the panel, as gymnasium does after drawing the world."""
    flipped = pygame.transform.flip(surface, False, True)
    flipped.fill((0, 0, 0), (0, 700, 1000, 100))
    return flipped


def turn(a, b, c):
    """Return which way the corner at `b` turns."""
    return np.sign((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]))


def drawn(quads, colours, car=None):
    """Return what our loops make of quads in surface coordinates and polygons over them."""
    count = len(quads)
    if car is None:
        xs = np.zeros((1, MAX_CORNERS), np.int64)
        car = (xs, xs.copy(), np.zeros(1, np.int64), np.zeros(1, np.uint32))
    out = np.empty((96, 96, 3), np.uint8)
    # A quad around the surface stands for the field, and is the background.
    scanline.draw_frame(
        np.concatenate((np.zeros((1, 4, 2)), np.asarray(quads, np.float64).reshape(-1, 4, 2))),
        np.tile((500.0, 400.0, 1e6), (count + 1, 1)),
        np.concatenate(([0], colours)).astype(np.uint32),
        UNTURNED,
        0,
        1e9,
        *car,
        np.array([NO_BAR]),
        BAR_COLOURS,
        np.zeros((1, 1), np.uint32),
        0,
        799,
        scanline.make_scratch(count + 1),
        out,
    )
    return out


def test_ten_thousand_windows_shrink_as_smoothscale_shrinks_them():
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (1000, 800, 3), np.uint8)
    surface = pygame.Surface((1000, 800))
    pygame.surfarray.blit_array(surface, pixels)
    values = pixels.astype(np.int64)
    for axis, size in ((0, 1000), (1, 800)):
        tables = shrink_tables(size, 96)
        values = np.moveaxis(values, axis, 0)
        windows = []
        for i in range(96):
            first, last = tables.first[i], tables.last[i]
            total = values[first + 1 : last].sum(axis=0)
            for end, weight in ((first, tables.first_weight[i]), (last, tables.last_weight[i])):
                total += values[end] * 4 * weight >> 16
            windows.append(total * tables.reciprocal >> 16)
        values = np.moveaxis(np.array(windows), 0, axis)
    assert np.array_equal(values.transpose(1, 0, 2), shrunk(surface))


def test_a_size_whose_flat_windows_differ_is_refused():
    with pytest.raises(ValueError, match='windows of one colour differ'):
        for source in range(100, 400, 7):
            shrink_tables(source, 96)


@pytest.mark.parametrize('kind', ['any', 'small', 'thin', 'large', 'level'])
def test_random_quads_are_filled_and_smoothed_as_sdl_gfx_does_it(kind):
    rng = np.random.default_rng(['any', 'small', 'thin', 'large', 'level'].index(kind))
    folded = 0
    for _ in range(25):
        quads = []
        for _ in range(30):
            centre = rng.uniform((-100, 50), (1100, 850))
            size = {'any': 300, 'small': 3, 'thin': 150, 'large': 3000, 'level': 200}[kind]
            corners = centre + rng.uniform(-size, size, (4, 2))
            if kind == 'thin':
                along = rng.uniform(-size, size, 2)
                corners = centre + np.array([-along, along, along, -along])
                corners += rng.uniform(-3, 3, (4, 2))
            if kind == 'level':
                corners = corners // 40 * 40
            quads.append(corners)
        colours = rng.integers(0, 1 << 24, len(quads))
        surface = pygame.Surface((1000, 800))
        for corners, colour in zip(quads, colours):
            near = (corners >= -scanline.MAX_SHAPE_DIM) & (
                corners <= np.array([1000, 800]) + scanline.MAX_SHAPE_DIM
            )
            if not near.all(axis=1).any():
                continue
            points = [tuple(map(float, corner)) for corner in corners]
            gfxdraw.aapolygon(surface, points, rgb_of(colour))
            gfxdraw.filled_polygon(surface, points, rgb_of(colour))
            a, b, c, d = corners
            folded += turn(a, b, c) * turn(c, d, a) < 0
        assert np.array_equal(drawn(quads, colours), shrunk(with_panel(surface)))
    assert folded, 'no quad folded over itself, so the split filler was not tried'


def test_random_polygons_of_a_car_are_filled_as_pygame_does_it():
    rng = np.random.default_rng(5)
    for trial in range(60):
        count = 8
        corners = rng.integers(3, MAX_CORNERS + 1, count)
        # pygame fills triangles with another routine, which no part of a car needs.
        corners[corners == 3] = 4
        corners[0] = 0
        width, height = ((60, 60), (4, 4), (600, 40))[trial % 3]
        xs = np.zeros((count, MAX_CORNERS), np.int64)
        ys = np.zeros((count, MAX_CORNERS), np.int64)
        colours = rng.integers(0, 1 << 24, count).astype(np.uint32)
        surface = pygame.Surface((1000, 800))
        for i in range(count):
            xs[i] = rng.integers(0, 1000) + rng.integers(-width, width + 1, MAX_CORNERS)
            ys[i] = rng.integers(100, 800) + rng.integers(-height, height + 1, MAX_CORNERS)
            if trial % 5 == 4:
                ys[i] = ys[i] // 7 * 7
            if corners[i]:
                points = list(zip(xs[i, : corners[i]].tolist(), ys[i, : corners[i]].tolist()))
                pygame.draw.polygon(surface, rgb_of(colours[i]), points)
        ours = drawn([], np.zeros(0), (xs, ys, corners, colours))
        assert np.array_equal(ours, shrunk(with_panel(surface)))


def test_rotation_equals_pygames_near_every_right_angle_and_elsewhere():
    rng = np.random.default_rng(2)
    angles = list(rng.uniform(-50, 50, 500))
    for turns in range(-8, 9):
        for slack in (0.0, 0.5e-6, -0.5e-6, 0.99e-6, 1.5e-6, -1.5e-6):
            angles.append(turns * np.pi / 2 + slack)
    for angle in angles:
        cosine, sine = rotation(angle)
        x, y = 217.53, -54.355
        turned = pygame.math.Vector2(x, y).rotate_rad(angle)
        assert (cosine * x - sine * y, sine * x + cosine * y) == (turned.x, turned.y)


def test_a_sample_of_all_driving_equals_gymnasium_in_every_byte():
    found = compare(1200, episode_frames=110, repeats=(1, 4))
    assert found.frames == 1200
    assert not found.differences, found.first_difference
    for kind in ('zooming in', 'off the road', 'spinning', 'action repeat', 'other colours'):
        assert found.variety[kind] > 20, f'too few frames {kind}'


def test_a_finished_lap_equals_gymnasium_to_its_end():
    env = make_env(renderer='fast', action_repeat=4)
    stock = CarRacing()
    env.reset(seed=8)
    stock.reset(seed=8)
    driver = Driver(env, 'lap')
    # Gymnasium draws every frame; only the last stretch is compared, so it need not before.
    draw = CarRacing._render
    stock._render = lambda mode: None
    compared = 0
    terminated = truncated = False
    while not terminated and not truncated:
        action = driver.act()
        near_end = env.facts().tiles_visited > env.facts().tiles_total - 25
        frame, reward, terminated, truncated, info = env.step(action, draw=near_end)
        if near_end:
            stock._render = lambda mode: draw(stock, mode)
        total = 0.0
        for _ in range(info['frames']):
            expected, part, stock_terminated, _, stock_info = stock.step(action)
            total += part
        assert total == reward
        assert terminated == stock_terminated
        if near_end:
            assert np.array_equal(frame, expected)
            compared += 1
    assert terminated and info['lap_finished'] and stock_info == {'lap_finished': True}
    assert compared > 10


def test_leaving_the_playfield_equals_gymnasium_to_its_end():
    found = compare(600, styles=('away',), repeats=(1,), first_seed=40)
    assert not found.differences, found.first_difference
    assert found.variety['left the playfield'] >= 1


def test_without_zoom_the_first_second_is_drawn_as_what_follows():
    env = make_env(renderer='fast', zoom=False)
    stock = CarRacing()
    env.reset(seed=11)
    stock.reset(seed=11)
    for _ in range(20):
        action = np.array([0.1, 0.5, 0.0], np.float32)
        frame = env.step(action)[0]
        stock.t = 1.0
        assert np.array_equal(frame, stock.step(action)[0])


def test_the_frame_belongs_to_the_caller():
    env = make_env(renderer='fast')
    first, _ = env.reset(seed=1)
    kept = first.copy()
    second = env.step(np.array([0.0, 1.0, 0.0], np.float32))[0]
    assert np.array_equal(first, kept)
    second[:] = 0
    assert env.draw().any()


def test_every_frame_runs_the_loops_that_were_warmed_up():
    env = make_env(renderer='fast')
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert len(scanline.draw_frame.signatures) == 1
    assert len(place_polygons.signatures) == 1


def test_the_guard_finds_nothing_here_and_something_under_another_filter():
    assert guard.compare((3,), 5) == ''
    before = pygame.transform.get_smoothscale_backend()
    pygame.transform.set_smoothscale_backend('GENERIC')
    try:
        assert guard.surroundings() not in guard.PROVEN
        assert 'seed 3' in guard.compare((3,), 5)
    finally:
        pygame.transform.set_smoothscale_backend(before)


def test_a_difference_leads_to_gymnasiums_own_code_with_a_warning():
    script = """
import warnings
import numpy as np, pygame
pygame.transform.set_smoothscale_backend('GENERIC')
from gymnasium.envs.box2d.car_racing import CarRacing
from carracing_sim_node import RendererUnavailableError, RendererWarning, make_env
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter('always')
    env = make_env()
assert [w.category for w in caught] == [RendererWarning], caught
assert 'differs from gymnasium' in str(caught[0].message)
assert env.renderer_name == 'stock'
stock = CarRacing()
assert np.array_equal(env.reset(seed=2)[0], stock.reset(seed=2)[0])
for _ in range(5):
    action = np.array([0.3, 1.0, 0.0], np.float32)
    ours, theirs = env.step(action), stock.step(action)
    assert np.array_equal(ours[0], theirs[0]) and ours[1:] == theirs[1:]
assert env.facts().tiles_visited > 0
try:
    make_env(renderer='fast')
except RendererUnavailableError:
    print('refused')
"""
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout == 'refused\n', done.stderr


def test_without_numba_gymnasiums_own_code_takes_over_with_a_warning():
    script = """
import sys, warnings
sys.modules['numba'] = None
from carracing_sim_node import RendererUnavailableError, make_env
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter('always')
    env = make_env()
assert 'needs Numba' in str(caught[0].message), caught
assert env.renderer_name == 'stock'
assert env.reset(seed=2)[0].shape == (96, 96, 3)
try:
    make_env(renderer='fast')
except RendererUnavailableError:
    print('refused')
"""
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout == 'refused\n', done.stderr
