# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages <-> arrays: what is accepted, what is refused, and that nothing is changed."""
import math

from geometry_msgs.msg import Twist
from hypothesis import given, strategies
from msgs_bridge.errors import MessageError
from msgs_bridge.images import fill_image, image_to_array
from msgs_bridge.named_values import fill_named_values, read_named_values
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step_fields import STEP_FIELDS
from msgs_bridge.twists import Action, fill_twist, twist_to_action
import numpy as np
import pytest
from sensor_msgs.msg import Image, JointState

PIXELS = np.random.default_rng(1).integers(0, 256, (96, 96, 3), np.uint8)


def image():
    return fill_image(Image(), PIXELS, 1_020_000_000, 'car_top_down')


def test_image_comes_back_unchanged():
    message = image()
    assert np.array_equal(image_to_array(message), PIXELS)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 20_000_000)
    assert (message.encoding, message.step, message.is_bigendian) == ('rgb8', 288, 0)


def test_bgr_with_padded_rows_is_read_as_rgb():
    message = image()
    message.encoding, message.step = 'bgr8', 300
    rows = np.zeros((96, 300), np.uint8)
    rows[:, :288] = PIXELS[:, :, ::-1].reshape(96, 288)
    message.data = rows.tobytes()
    assert np.array_equal(image_to_array(message), PIXELS)


@pytest.mark.parametrize('change, words', [
    ({'encoding': 'mono16'}, "'mono16'"),
    ({'height': 0}, '96x0'),
    ({'width': 100_000}, '100000x96'),
    ({'step': 287}, 'step 287'),
    ({'height': 97}, 'header says'),
    ({'data': b'123'}, '3 bytes'),
])
def test_an_image_that_lies_is_refused(change, words):
    message = image()
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(MessageError, match=words):
        image_to_array(message)


@given(strategies.floats(-1, 1), strategies.floats(-1, 1))
def test_an_action_survives_its_twist(steer, pedal):
    action = Action(steer, max(pedal, 0.0), max(-pedal, 0.0))
    back, clamped = twist_to_action(fill_twist(Twist(), action))
    assert back == action and not clamped


def test_a_turn_to_the_left_is_positive_angular_z():
    assert fill_twist(Twist(), Action(-1.0, 0.0, 0.0)).angular.z == 1.0


def test_twists_out_of_range_are_clamped_and_nan_is_refused():
    twist = Twist()
    twist.linear.x, twist.angular.z = 7.0, -3.0
    assert twist_to_action(twist) == (Action(1.0, 1.0, 0.0), True)
    twist.angular.z = math.nan
    with pytest.raises(MessageError, match='nan'):
        twist_to_action(twist)
    with pytest.raises(MessageError, match='at once'):
        fill_twist(Twist(), Action(0.0, 0.5, 0.5))


def test_named_values():
    message = fill_named_values(JointState(), {'reward': 3.25, 'step': 4}, 5_000_000_007)
    assert read_named_values(message, ['reward']) == {'reward': 3.25, 'step': 4.0}
    assert to_nanoseconds(message.header.stamp) == 5_000_000_007
    with pytest.raises(MessageError, match="lacks 'terminated'"):
        read_named_values(message, STEP_FIELDS)
    message.position[0] = math.inf
    with pytest.raises(MessageError, match='reward is inf'):
        read_named_values(message, ['reward'])
    message.position.pop()
    with pytest.raises(MessageError, match='2 names but 1 values'):
        read_named_values(message, ['reward'])
