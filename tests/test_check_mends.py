# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing check`: what it says mends something does mend it."""
from __future__ import annotations

import contextlib
import re

from carracing_dqn.simulation.fit import (
    BAD, findings, GOOD, IMAGE_TYPE, Seen, STAMPED_TYPE, UNSURE, Wanted,
)
from dqn_policy_node.camera import Camera
from dqn_policy_node.settings import PolicySettings
from msgs_bridge.errors import MessageError
from msgs_bridge.settings import from_mapping
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage, Image

SIDE = 96


def looked_at(message, vehicle, camera=(), count=20):
    """Return name -> finding for a car whose camera sends one image over and over."""
    eyes = Camera(from_mapping(PolicySettings, dict(vehicle)), SIDE, SIDE)
    frames = []
    with contextlib.suppress(MessageError):
        frames = [eyes.frame(message)] * count
    compressed = isinstance(message, CompressedImage)
    stamps = [10 ** 9 + number * 20_000_000 for number in range(count)]
    seen = Seen(
        '/image_raw', '/cmd_vel', [IMAGE_TYPE], [], [stamp / 1e9 for stamp in stamps], stamps,
        {message.format if compressed else message.encoding},
        {(SIDE, SIDE)} if compressed else {(message.width, message.height)}, set(),
        [('', frames)],
        ['reliable'], [STAMPED_TYPE], [], [], True)
    wanted = Wanted(dict(vehicle), dict(camera), (SIDE, SIDE), 0.04)
    return {one.name: one for one in findings(seen, wanted)}


def image(pixels, encoding):
    height, width, channels = pixels.shape
    return Image(height=height, width=width, step=width * channels, encoding=encoding,
                 data=pixels.tobytes())


def mended(finding):
    """Return the parameter that a finding names."""
    name, value = re.search(r"(\w+):='?([\w,]+)", finding.mend).groups()
    return {name: value}


@pytest.mark.parametrize('vehicle', [
    {}, {'camera_turn': '90'}, {'camera_turn': '270', 'camera_mirror': True},
    {'camera_crop': '100,40,400,300'}, {'camera_crop': '100,40,300,400', 'camera_turn': '90'},
    {'camera_crop': ' '}])
def test_the_crop_that_is_named_keeps_the_proportions_of_what_the_model_sees(vehicle):
    message = image(np.arange(640 * 480 * 3, dtype=np.uint8).reshape(480, 640, 3), 'rgb8')
    before = looked_at(message, vehicle)['size']
    assert before.verdict == BAD and 'squeezed' in before.found
    crop = mended(before)
    assert looked_at(message, {**vehicle, **crop})['size'].verdict == GOOD
    # and it is a part of what is looked at now
    left, top, width, height = map(int, crop['camera_crop'].split(','))
    now = tuple(map(int, (vehicle.get('camera_crop', '').strip() or '0,0,640,480').split(',')))
    assert now[0] <= left and left + width <= now[0] + now[2]
    assert now[1] <= top and top + height <= now[1] + now[3]


@pytest.mark.parametrize(('says', 'vehicle'), [
    ('rgb8', {}), ('bgr8', {}), ('rgba8', {}), ('bgra8', {}), ('8UC3', {}),
    ('rgb8', {'camera_encoding': 'bgr8'}), ('bgr8', {'camera_encoding': 'rgb8'}),
    ('rgba8', {'camera_encoding': 'bgra8'})])
def test_the_encoding_that_is_named_puts_red_where_it_belongs(says, vehicle):
    pixels = np.zeros((SIDE, SIDE, 4 if 'a' in says else 3), np.uint8)
    pixels[..., 0], pixels[::2, :, 2] = 200, 60
    message = image(pixels, says)
    # what is known of the camera is the other way round than it is read
    told = looked_at(message, vehicle)['colours'].found.split('blue ')[1]
    camera = {'mean_rgb': [float(one) for one in told.split(', ')][::-1]}
    before = looked_at(message, vehicle, camera)['colours']
    assert before.verdict == BAD and 'exchanged' in before.found
    assert looked_at(message, {**vehicle, **mended(before)}, camera)['colours'].verdict == GOOD


@pytest.mark.parametrize('vehicle', [{}, {'camera_encoding': 'bgr8'}])
def test_of_compressed_images_too(vehicle):
    from msgs_bridge.images import fill_compressed_image
    pixels = np.zeros((SIDE, SIDE, 3), np.uint8)
    pixels[..., 0], pixels[::2, :, 2] = 200, 60
    message = fill_compressed_image(CompressedImage(), pixels, 1, '')
    vehicle = {'camera_compressed': True, **vehicle}
    red_first = 'camera_encoding' in vehicle
    camera = {'mean_rgb': [200, 0, 30] if red_first else [30, 0, 200]}
    before = looked_at(message, vehicle, camera)['colours']
    assert before.verdict == BAD and 'exchanged' in before.found
    assert looked_at(message, {**vehicle, **mended(before)}, camera)['colours'].verdict == GOOD


def test_one_image_says_nothing_of_the_clock():
    message = image(np.eye(SIDE, dtype=np.uint8)[:, :, None].repeat(3, 2), 'rgb8')
    found = looked_at(message, {}, count=1)
    assert found['stamps'].verdict == found['rate'].verdict == UNSURE
    assert 'too few' in found['stamps'].found
