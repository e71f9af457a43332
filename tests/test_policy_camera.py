# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Any camera in front, any robot behind: pixels, encodings, sizes, units, limits."""
import contextlib
import io
import math

from dqn_policy_node.camera import Camera, CameraSettings
from dqn_policy_node.command_stage import CommandSettings, CommandStage
from dqn_policy_node.settings import PolicySettings
from hypothesis import given, settings, strategies
from msgs_bridge.errors import MessageError, SettingsError
from msgs_bridge.images import (
    compressed_to_array, ENCODINGS, fill_compressed_image, fill_image, image_to_array,
)
from msgs_bridge.picture_parts import parse_crop
from msgs_bridge.twists import Command, STOP
import numpy as np
from PIL import Image as Picture
import pytest
from sensor_msgs.msg import CompressedImage, Image

RANDOM = np.random.default_rng(0)
RGB = RANDOM.integers(0, 256, (48, 64, 3), np.uint8)


def message(pixels, encoding, padding=0):
    """Return an Image of some bytes a pixel, with rows that are longer than they need be."""
    rows = pixels.reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return Image(height=len(pixels), width=pixels.shape[1], encoding=encoding,
                 step=rows.shape[1], data=rows.tobytes())


@pytest.mark.parametrize('padding', [0, 5])
def test_every_encoding_gives_the_same_picture(padding):
    alpha = np.full((48, 64, 1), 9, np.uint8)
    for encoding, pixels in {
        'rgb8': RGB, 'bgr8': RGB[..., ::-1], '8UC3': RGB[..., ::-1],
        'rgba8': np.concatenate([RGB, alpha], 2),
        'bgra8': np.concatenate([RGB[..., ::-1], alpha], 2),
    }.items():
        assert np.array_equal(image_to_array(message(pixels, encoding, padding)), RGB), encoding
    gray = RGB[..., 0]
    for encoding in ('mono8', '8UC1'):
        found = image_to_array(message(gray, encoding, padding))
        assert np.array_equal(found, np.stack([gray] * 3, 2))
    # what a camera says wrongly is said by the parameter
    assert np.array_equal(image_to_array(message(RGB, '8UC3'), 'rgb8'), RGB)


def test_jpeg_and_png_are_unpacked_and_nothing_else_is():
    for kind in ('PNG', 'JPEG', 'GIF', 'BMP'):
        data = io.BytesIO()
        Picture.fromarray(RGB).save(data, kind)
        packed = CompressedImage(format=kind.lower(), data=data.getvalue())
        if kind == 'PNG':
            assert np.array_equal(compressed_to_array(packed), RGB)
        elif kind == 'JPEG':
            assert compressed_to_array(packed).shape == RGB.shape
        else:
            with pytest.raises(MessageError, match='neither jpeg nor png'):
                compressed_to_array(packed)
    for cut in (0, 20, 200):
        with pytest.raises(MessageError, match='image'):
            compressed_to_array(CompressedImage(data=data.getvalue()[:cut]))


def test_an_image_of_ours_comes_back_to_the_byte():
    random = np.random.default_rng(0)
    for shape in ((96, 96, 3), (1, 7, 3), (48, 64, 3)):
        pixels = random.integers(0, 256, shape, np.uint8)
        message = fill_compressed_image(CompressedImage(), pixels, 7 * 10**9 + 1, 'eye')
        assert np.array_equal(compressed_to_array(message), pixels)
        assert (message.format, message.header.frame_id) == ('png', 'eye')
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 1)


def test_a_picture_that_would_unfold_to_gigabytes_is_refused_before_it_does():
    data = io.BytesIO()
    Picture.new('1', (5000, 5000)).save(data, 'PNG')
    assert len(data.getvalue()) < 10_000
    with pytest.raises(MessageError, match='5000x5000'):
        compressed_to_array(CompressedImage(data=data.getvalue()))


@settings(max_examples=200, deadline=None)
@given(strategies.binary(max_size=400), strategies.integers(0, 2**32 - 1),
       strategies.integers(0, 2**32 - 1), strategies.integers(0, 2**32 - 1),
       strategies.sampled_from([*ENCODINGS, '', 'mono16', 'x' * 10_000]), strategies.booleans())
def test_no_image_raises_anything_but_our_error(data, height, width, step, encoding, small):
    if small:
        height, width, step = height % 20, width % 20, step % 60
    image = Image(height=height, width=width, step=step, encoding=encoding, data=data)
    camera = Camera(CameraSettings(), 8, 8)
    try:
        assert camera.frame(image).shape == (8, 8, 3)
    except MessageError as error:
        assert len(str(error)) < 300
    with contextlib.suppress(MessageError):
        compressed_to_array(CompressedImage(data=b'\xff\xd8\xff' + data))


def test_an_image_that_needs_nothing_is_not_copied():
    image = fill_image(Image(), RGB, 0, 'camera')
    frame = Camera(CameraSettings(), 48, 64).frame(image)
    assert np.array_equal(frame, RGB) and np.shares_memory(frame, np.frombuffer(image.data, 'u1'))


def test_other_sizes_are_averaged_by_area():
    frame = Camera(CameraSettings(), 24, 32).frame(message(RGB, 'rgb8'))
    means = RGB.reshape(24, 2, 32, 2, 3).mean((1, 3))
    assert frame.shape == (24, 32, 3) and np.abs(frame - means).max() <= 1


def test_crop_turn_and_mirror_come_in_this_order():
    part = RGB[10:30, 5:35]
    for turn, turned in (('90', np.rot90(part, -1)), ('180', part[::-1, ::-1]),
                         ('270', np.rot90(part))):
        own = CameraSettings(camera_crop='5,10,30,20', camera_turn=turn, camera_mirror=True)
        frame = Camera(own, *turned.shape[:2]).frame(message(RGB, 'rgb8'))
        assert np.array_equal(frame, turned[:, ::-1])


@pytest.mark.parametrize('text', ['1', 'a,b,c,d', '1,2,3', '0,0,0,5', '-1,0,5,5', '0,0,9999,5'])
def test_a_crop_that_is_none_is_refused(text):
    with pytest.raises(SettingsError, match='camera_crop'):
        parse_crop('camera_crop', text)
    with pytest.raises(MessageError, match='does not fit on an image of 64x48'):
        Camera(CameraSettings(camera_crop='60,0,10,10'), 8, 8).frame(message(RGB, 'rgb8'))


@given(strategies.floats(-1, 1), strategies.floats(-1, 1))
def test_what_the_policy_scales_the_trainer_undoes(linear, angular):
    own = CommandSettings(
        linear_scale=0.8, linear_offset=0.3, angular_scale=-1.5, angular_offset=0.1)
    back = own.from_robot(own.to_robot(Command(linear, angular)))
    assert back == pytest.approx((linear, angular), abs=1e-9)
    assert CommandStage(CommandSettings()).twist(Command(linear, angular), 0.02) == (
        linear, angular)


@given(strategies.lists(strategies.tuples(
    strategies.floats(-1, 1), strategies.floats(-1, 1), strategies.floats(0, 0.4))))
def test_limits_and_rates_hold_for_any_commands(commands):
    for drive in ('direct', 'ackermann'):
        stage = CommandStage(CommandSettings(
            drive=drive, linear_scale=3.0, angular_scale=4.0, linear_low=0.0, linear_high=1.2,
            linear_rate=2.0, angular_limit=1.0, angular_rate=5.0))
        last = STOP
        for linear, angular, seconds in commands:
            twist = stage.twist(Command(linear, angular), seconds)
            assert 0 <= twist.linear <= 1.2 and abs(twist.angular) <= 1
            assert abs(twist.linear - last.linear) <= 2.0 * seconds + 1e-9
            assert abs(twist.angular - last.angular) <= 5.0 * seconds + 1e-9
            last = twist
        assert stage.stop() == STOP


def test_an_ackermann_car_gathers_speed_turns_by_its_wheels_and_coasts():
    stage = CommandStage(CommandSettings(
        drive='ackermann', acceleration=2.0, deceleration=4.0, coasting=0.5, wheelbase=0.5,
        steering_limit=0.3))
    for _ in range(10):
        twist = stage.twist(Command(1.0, 1.0), 0.1)
    assert twist.linear == pytest.approx(2.0)
    assert twist.angular == pytest.approx(2.0 * math.tan(0.3) / 0.5)
    assert stage.twist(Command(0.0, 0.0), 0.1).linear == pytest.approx(1.95)
    assert stage.twist(Command(-1.0, 0.0), 0.1).linear == pytest.approx(1.55)
    # a robot with the other sign that counts in cm/s
    mirrored = CommandStage(CommandSettings(
        drive='ackermann', acceleration=2.0, linear_scale=100.0, angular_scale=-1.0,
        linear_low=0.0, linear_high=150.0))
    for _ in range(10):
        twist = mirrored.twist(Command(1.0, 1.0), 0.1)
    assert twist == Command(pytest.approx(150.0), pytest.approx(-1.5 * math.tan(0.4) / 0.3))
    with pytest.raises(SettingsError, match='linear_low'):
        CommandSettings(linear_low=1.0, linear_high=0.0)


def test_a_policy_that_neither_has_weights_nor_takes_any_is_refused():
    """It would say for ever that it waits for weights."""
    with pytest.raises(SettingsError, match='model is empty.*hot_swap is false'):
        PolicySettings(model='', hot_swap=False)
    with pytest.raises(SettingsError, match='linear_low'):
        PolicySettings(linear_low=1.0, linear_high=0.0)
    assert PolicySettings(model='').hot_swap and not PolicySettings(hot_swap=False).hot_swap
