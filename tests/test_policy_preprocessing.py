# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Frames to observations, against plain arithmetic."""
import time

from dqn_policy_node.frame_stack import FrameStack
from dqn_policy_node.model_description import Preprocessing
from dqn_policy_node.preprocessing import Preprocessor
from msgs_bridge.errors import MessageError
import numpy as np
import pytest


@pytest.fixture
def frame():
    return np.random.default_rng(0).integers(0, 256, (96, 96, 3), np.uint8)


def test_mean_gray_is_the_rounded_mean_of_the_channels(frame):
    expected = np.floor(frame.mean(axis=2) + 0.5)
    assert np.array_equal(Preprocessor(Preprocessing())(frame), expected)


def test_luma_is_bt601_to_a_level(frame):
    expected = frame @ np.array([0.299, 0.587, 0.114])
    got = Preprocessor(Preprocessing(gray='luma'))(frame)
    assert np.abs(got - expected).max() < 1.5


@pytest.mark.parametrize('shrink', [2, 3, 4])
def test_shrinking_averages_squares_of_the_crop(frame, shrink):
    own = Preprocessing(first_row=4, rows=48, first_column=6, columns=84, shrink=shrink)
    gray = np.floor(frame.mean(axis=2) + 0.5)[4:52, 6:90]
    squares = gray.reshape(48 // shrink, shrink, 84 // shrink, shrink).mean(axis=(1, 3))
    got = Preprocessor(own)(frame)
    assert got.shape == own.shape == (48 // shrink, 84 // shrink)
    assert got.dtype == np.uint8
    assert np.array_equal(got, np.floor(squares + 0.5))


def test_flat_road_makes_the_four_shades_one_and_leaves_grass_alone():
    frame = np.zeros((96, 96, 3), np.uint8)
    for column, shade in enumerate((102, 104, 107)):
        frame[:, column] = shade
    frame[:, 3] = (102, 204, 102)
    frame[:, 4] = (102, 230, 102)
    got = Preprocessor(Preprocessing(road='flat'))(frame)[0, :6]
    assert got.tolist() == [102, 102, 102, 136, 145, 0]


def test_contrast_darkens_unvisited_road_and_leaves_the_rest_alone():
    frame = np.zeros((96, 96, 3), np.uint8)
    for column, shade in enumerate((100, 102, 104, 107, 108, 136, 97)):
        frame[:, column] = shade
    got = Preprocessor(Preprocessing(road='contrast'))(frame)[0, :7]
    assert got.tolist() == [102, 102, 84, 57, 108, 136, 97]


def test_a_frame_of_another_size_or_type_is_refused(frame):
    own = Preprocessor(Preprocessing())
    for wrong in (frame[:95], frame[..., 0], frame.astype(np.float32)):
        with pytest.raises(MessageError, match='expected uint8'):
            own(wrong)


def test_a_read_only_view_with_long_rows_will_do(frame):
    wide = np.zeros((96, 120, 3), np.uint8)
    wide[:, :96] = frame
    wide.flags.writeable = False
    own = Preprocessor(Preprocessing(shrink=2))
    assert np.array_equal(own(wide[:, :96]), own(frame))


def test_it_takes_far_less_than_a_frame_lasts(frame):
    own = Preprocessor(Preprocessing(shrink=2, road='flat'))
    times = []
    for _ in range(50):
        start = time.perf_counter()
        own(frame)
        times.append(time.perf_counter() - start)
    assert min(times) < 100e-6


def test_the_first_observation_fills_the_stack():
    stack = FrameStack(3, (1, 1))
    observations = [np.full((1, 1), level, np.uint8) for level in (5, 6, 7, 8)]
    seen = [stack.push(observation).ravel().tolist() for observation in observations]
    assert seen == [[5, 5, 5], [5, 5, 6], [5, 6, 7], [6, 7, 8]]
    stack.reset()
    assert stack.push(np.full((1, 1), 9, np.uint8)).ravel().tolist() == [9, 9, 9]


def test_observations_may_come_more_often_than_the_stack_is_spaced():
    stack = FrameStack(3, (1, 1), spacing=4)
    observations = [np.full((1, 1), level, np.uint8) for level in range(8)]
    seen = [stack.push(observation, 2).ravel().tolist() for observation in observations]
    assert seen[:4] == [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 1, 3]]
    assert seen[6:] == [[2, 4, 6], [3, 5, 7]]
    assert stack.push(observations[0], 4).ravel().tolist() == [5, 7, 0]
