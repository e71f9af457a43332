# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages <-> arrays: what is accepted, what is refused, and that nothing is changed."""
import io
import math
import struct
import subprocess
import sys
import zlib

from geometry_msgs.msg import Twist
from hypothesis import given, strategies
from carracing_sim_node.controls import command_of, controls
from msgs_bridge.errors import MessageError
from msgs_bridge.images import compressed_to_array, fill_image, image_to_array
from msgs_bridge.named_values import fill_named_values, read_named_values
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import MAX_NAMES, read_step, STEP_CORE
from msgs_bridge.twists import Command, fill_twist, read_command
import numpy as np
from PIL import Image as Picture
import pytest
from sensor_msgs.msg import CompressedImage, Image, JointState

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
def test_a_command_survives_its_twist(steer, pedal):
    command = Command(pedal, steer)
    assert read_command(fill_twist(Twist(), command)) == command == command.clamped()
    steer, gas, brake = controls(command)
    assert command_of(steer, gas, brake) == command and not (gas and brake)


def test_a_turn_to_the_left_is_positive_angular_z():
    assert fill_twist(Twist(), command_of(-1.0, 0.0, 0.0)).angular.z == 1.0


def test_twists_out_of_range_are_clamped_and_nan_is_refused():
    twist = Twist()
    twist.linear.x, twist.angular.z = 7.0, -3.0
    assert controls(read_command(twist).clamped()) == (1.0, 1.0, 0.0)
    twist.angular.z = math.nan
    with pytest.raises(MessageError, match='nan'):
        read_command(twist)


def png_with(kind, content=b''):
    """Return a PNG with one more chunk before its end."""
    packed = io.BytesIO()
    Picture.fromarray(PIXELS).save(packed, 'PNG')
    data = packed.getvalue()
    end = data.rindex(b'IEND') - 4
    chunk = kind + content
    return (data[:end] + struct.pack('>I', len(content)) + chunk
            + struct.pack('>I', zlib.crc32(chunk)) + data[end:])


@pytest.mark.parametrize('data', [
    png_with(b'iCCP'), png_with(b'gAMA'), png_with(b'tEXt')[:200], b'\x89PNG\r\n\x1a\n', b'',
    b'x'])
def test_a_compressed_image_that_cannot_be_unpacked_raises_nothing_else(data):
    with pytest.raises(MessageError, match='image'):
        compressed_to_array(CompressedImage(format='png', data=data))


WARNING = """
import sys
from msgs_bridge.images import compressed_to_array
from msgs_bridge.errors import MessageError
from sensor_msgs.msg import CompressedImage
for _ in range(3):
    try:
        compressed_to_array(CompressedImage(data=sys.stdin.buffer.read()))
    except MessageError:
        pass
"""


def test_what_pil_thinks_of_an_image_is_no_line_on_stderr():
    wide = bytearray(png_with(b'tEXt', b'a\0b'))
    wide[16:24] = struct.pack('>II', 10_000, 10_000)
    wide[29:33] = struct.pack('>I', zlib.crc32(wide[12:29]))
    done = subprocess.run([sys.executable, '-c', WARNING], input=bytes(wide),
                          capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, b'')


def test_a_bundle_is_bounded_in_names():
    message = JointState(name=[f'x{number}' for number in range(MAX_NAMES + 1)])
    message.position = [0.0] * len(message.name)
    with pytest.raises(MessageError, match='257 values; accepted: up to 256'):
        read_named_values(message)
    message.name, message.position = ['x' * 101], [0.0]
    with pytest.raises(MessageError, match='101 characters'):
        read_named_values(message)


def test_named_values():
    message = fill_named_values(JointState(), {'reward': 3.25, 'step': 4}, 5_000_000_007)
    assert read_named_values(message, ['reward']) == {'reward': 3.25, 'step': 4.0}
    assert to_nanoseconds(message.header.stamp) == 5_000_000_007
    with pytest.raises(MessageError, match="lacks 'terminated'"):
        read_named_values(message, STEP_CORE)
    message.position[0] = math.inf
    with pytest.raises(MessageError, match='reward is inf'):
        read_named_values(message, ['reward'])
    message.position.pop()
    with pytest.raises(MessageError, match='2 names but 1 values'):
        read_named_values(message, ['reward'])


GOOD = {**dict.fromkeys(STEP_CORE, 0.0), 'reward': 1.5, 'seed': -1.0, 'applied_sec': 3.0,
        'applied_nanosec': 7.0, 'speed': 12.5}


def test_a_step_is_its_core_and_whatever_else_was_said():
    step = read_step(GOOD)
    assert (step.reward, step.applied, step.info) == (1.5, 3_000_000_007, {'speed': 12.5})
    assert not step.ended and read_step(step.values()) == step
    assert read_step({**GOOD, 'applied_sec': -1.0}).applied is None
    assert read_step({**GOOD, 'truncated': 1.0}).ended


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('reward', math.nan, 'reward is nan'), ('reward', 1e300, 'reward is 1e\\+300'),
    ('speed', math.inf, 'speed is inf'), ('episode', -1.0, 'episode is -1'),
    ('decision', 0.5, 'decision is 0.5'), ('episode', 1e12 ** 2, 'episode is 1e\\+24'),
    ('seed', -2.0, 'seed is -2'), ('applied_sec', 1e12, 'applied_sec'),
    ('applied_nanosec', 1e9, 'applied_nanosec'), ('x' * 101, 0.0, '101 characters'),
])
def test_a_step_that_cannot_be_is_refused(name, value, words):
    with pytest.raises(MessageError, match=words):
        read_step({**GOOD, name: value})
    for core in STEP_CORE:
        with pytest.raises(MessageError, match=f"lacks '{core}'"):
            read_step({key: value for key, value in GOOD.items() if key != core})


@given(strategies.dictionaries(
    strategies.sampled_from([*STEP_CORE, 'speed', 'steer']), strategies.floats()))
def test_no_step_raises_anything_but_our_error(values):
    try:
        step = read_step({**GOOD, **values})
    except MessageError:
        return
    assert math.isfinite(step.reward) and all(map(math.isfinite, step.info.values()))
