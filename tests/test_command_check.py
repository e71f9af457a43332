# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing check`: what does not fit is named, with the parameter that mends it."""
from __future__ import annotations

import _thread
from pathlib import Path
import struct
import threading
import time
import zlib

from carracing_dqn.bringup.check_node import look
from carracing_dqn.bringup.command import main
from carracing_dqn.simulation import make_simulator
from carracing_dqn.simulation.fit import (
    BAD, COMPRESSED_TYPE, findings, GOOD, IMAGE_TYPE, PLAIN_TYPE, Seen, STAMPED_TYPE, UNSURE,
    Wanted,
)
from carracing_dqn.simulation.picture_motion import sideways_shift, turned_left
from dqn_policy_node.settings import PolicySettings
from geometry_msgs.msg import TwistStamped
from msgs_bridge.images import fill_compressed_image, fill_image
from msgs_bridge.listening_node import node_of_a_command
from msgs_bridge.qos import qos_profile
from msgs_bridge.settings import from_mapping
from msgs_bridge.topics import CMD_VEL, IMAGE
from msgs_bridge.twists import Command
import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import CompressedImage, Image

RANDOM = np.random.default_rng(0)
WORLD = np.repeat(np.repeat(RANDOM.integers(0, 255, (40, 60, 3), np.uint8), 4, 0), 4, 1)


def view(column: int) -> np.ndarray:
    """Return a part of a world, from a column on."""
    return WORLD[:96, column:column + 96]


def good(**changes) -> Seen:
    """Return what is seen of a car with which everything is right, with some changes."""
    stamps = [10 ** 9 + number * 20_000_000 for number in range(60)]
    seen = Seen('/image_raw', '/cmd_vel', [IMAGE_TYPE], ['/image_raw'],
                [stamp / 1e9 for stamp in stamps], stamps, {'rgb8'}, {(96, 96)}, set(),
                [('', [view(50)] * 20), *2 * [
                    ('left', [view(50 - number) for number in range(20)]),
                    ('right', [view(50 + number) for number in range(20)])]],
                ['reliable'], [STAMPED_TYPE], [], [], True)
    for name, value in changes.items():
        setattr(seen, name, value)
    return seen


def verdicts(seen: Seen, vehicle=(), camera=()) -> dict:
    """Return name -> finding for a model that decides every 0.04 s on 96x96."""
    wanted = Wanted(dict(vehicle), dict(camera), (96, 96), 0.04)
    return {one.name: one for one in findings(seen, wanted)}


def test_a_car_that_fits_is_told_so():
    mean = [float(value) for value in np.mean(
        [one.reshape(-1, 3).mean(0) for _, series in good().frames for one in series], 0)]
    camera = {'width': 96, 'height': 96, 'encoding': 'rgb8', 'rate': 50, 'mean_rgb': mean}
    assert {one.verdict for one in verdicts(good(), (), camera).values()} == {GOOD}


def test_a_camera_that_compresses_is_not_said_to_send_nothing():
    seen = good(image_types=[COMPRESSED_TYPE], encodings={'jpeg'})
    found = verdicts(seen, {'camera_compressed': True})
    assert BAD not in {one.verdict for one in found.values()}
    assert found['size'].verdict == GOOD and 'the model sees 96x96' in found['size'].found


NOTHING = {'arrivals': [], 'stamps': [], 'image_types': []}
CASES = [
    ('images', NOTHING, {}, {}, BAD, '-r image_raw:=/camera/image'),
    ('images', {'image_types': [COMPRESSED_TYPE]}, {}, {}, BAD, 'camera_compressed:=true'),
    ('images', {}, {'camera_compressed': True}, {}, BAD, 'camera_compressed:=false'),
    ('images', {'arrivals': [], 'stamps': []}, {}, {}, BAD, '--nudge'),
    ('images', {'refused': {'image step 3'}}, {}, {}, BAD, 'camera_encoding'),
    ('rate', {}, {}, {'rate': 30}, BAD, 'camera.rate'),
    ('rate', {'stamps': [number * 10 ** 8 for number in range(60)]}, {}, {}, BAD,
     'a faster camera'),
    ('stamps', {'stamps': [0] * 60}, {}, {}, UNSURE, 'stamps its images'),
    ('stamps', {'stamps': [7] * 60}, {}, {}, UNSURE, 'stamps its images'),
    ('stamps', {'stamps': [9, 8, 7]}, {}, {}, BAD, 'one clock'),
    ('size', {'sizes': {(640, 480)}}, {}, {}, BAD, "camera_crop:='80,0,480,480'"),
    ('size', {}, {}, {'width': 640}, BAD, 'camera.width'),
    ('size', {'frames': []},
     {'camera_crop': '0,0,100,100'}, {}, BAD, 'camera_crop'),
    ('encoding', {}, {}, {'encoding': 'bgr8'}, BAD, 'camera.encoding'),
    ('encoding', {}, {'camera_encoding': 'bgr8'}, {}, UNSURE, 'camera_encoding'),
    ('colours', {'frames': [('', [np.zeros((96, 96, 3), np.uint8)])]},
     {}, {}, BAD, 'a camera that sees'),
    ('colours', {'frames': [('', [np.full((9, 9, 3), (90, 160, 20), np.uint8) ^ np.eye(
        9, dtype=np.uint8)[:, :, None]])]},
     {}, {'mean_rgb': [20, 160, 90]}, BAD, 'camera_encoding:=bgr8'),
    ('colours', {}, {}, {'mean_rgb': [1, 2, 3]}, BAD, 'camera.mean_rgb'),
    ('twists', {'twist_types': []}, {}, {}, BAD, '-r cmd_vel:=TOPIC'),
    ('twists', {'twist_types': [PLAIN_TYPE]}, {}, {}, BAD, 'cmd_vel_stamped:=false'),
    ('twists', {}, {'cmd_vel_stamped': False}, {}, BAD, 'cmd_vel_stamped:=true'),
    ('twists', {'deaf': ['QoS of /car does not match']}, {}, {}, BAD, 'QoS'),
    ('driver', {'drivers': ['/joystick']}, {}, {}, UNSURE, 'stop it'),
    ('steering', {'frames': [('', [view(0)])]}, {}, {}, UNSURE, '--nudge'),
    ('steering', {'frames': 2 * [('left', [view(9)] * 9), ('right', [view(9)] * 9)]}, {}, {},
     UNSURE, 'look at it'),
    ('steering', {'frames': 2 * [('left', good().told('right')[0]),
                                 ('right', good().told('left')[0])]}, {'angular_scale': 0.5}, {},
     BAD, 'angular_scale:=-0.5'),
    # a camera that turns by itself, once with what it was told and once against it
    ('steering', {'frames': [*good().frames, ('left', good().told('right')[0]),
                             ('right', good().told('left')[0])]}, {}, {}, UNSURE, 'look at it'),
    ('rate', {'stamps': [number * 20_000_000 + number // 10 * 10 ** 8 for number in range(60)]},
     {}, {}, UNSURE, 'keeps up'),
    ('step', {'steps': False}, {}, {}, UNSURE, 'referee'),
]


@pytest.mark.parametrize(('name', 'changes', 'vehicle', 'camera', 'verdict', 'mend'), CASES)
def test_what_does_not_fit_is_named_with_what_mends_it(
    name, changes, vehicle, camera, verdict, mend,
):
    seen = good(other_images=['/camera/image'], **changes)
    finding = verdicts(seen, vehicle, camera)[name]
    assert finding.verdict == verdict
    assert mend in finding.mend
    others = {one.verdict for other, one in verdicts(seen, vehicle, camera).items()
              if other not in (name, 'colours', 'size', 'steering', 'step')}
    assert BAD not in others


@pytest.mark.parametrize('shift', [-7, -1, 3, 12])
def test_a_shift_is_found_to_a_fraction_of_a_pixel(shift):
    assert sideways_shift(view(50), view(50 - shift)) == pytest.approx(shift, abs=0.3)


def test_pictures_that_have_nothing_in_common_say_nothing():
    noise = [RANDOM.integers(0, 255, (96, 96, 3), np.uint8) for _ in range(8)]
    assert turned_left([noise[:4]], [noise[4:]]) is None
    black = [np.zeros((96, 96, 3), np.uint8)] * 3
    assert turned_left([black], [black]) is None


@pytest.mark.parametrize('name', ['carracing'])
def test_in_carracing_left_is_left(name):
    simulator = make_simulator(name)
    frames = {1.0: [], -1.0: []}
    simulator.reset(7)
    simulator.advance(Command(0.5, 0.0), 60)
    for angular, kept in frames.items():
        for _ in range(25):
            kept.append(simulator.advance(Command(0.1, angular)).pixels)
    simulator.close()
    assert turned_left([frames[1.0]], [frames[-1.0]]) is True
    assert turned_left([frames[-1.0]], [frames[1.0]]) is False


@pytest.mark.parametrize(('words', 'told'), [
    (['nowhere'], 'no profile'), (['carracing', '--seconds', '0'], '--seconds is 0'),
    (['carracing', '--namespace', 'a b'], '--namespace'),
    (['carracing', '--model', 'nix'], "no model 'nix'"), (['none.yaml'], 'no such file')])
def test_wrong_words_are_one_line(capsys, words, told):
    assert main(['check', *words]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count('\n') == 1


@pytest.mark.parametrize('text', [
    'topics: {image_raw: 3}', 'topics: {image_raw: /front/bad-name}',
    'camera: {colour: red}', 'camera: {width: wide}',
    'camera: {mean_rgb: [1, 2]}', 'vehicle: {linear_skale: 1}'])
def test_a_profile_with_something_else_in_it_is_one_line(tmp_path, capsys, text):
    path = tmp_path / 'car.yaml'
    path.write_text(text)
    assert main(['check', str(path)]) == 2
    assert capsys.readouterr().err.count('\n') == 1


def test_a_car_that_is_nudged_stands_after_ctrl_c():
    space = '/nudged'
    node, executor = node_of_a_command('car', space)
    images = node.create_publisher(Image, IMAGE.name, qos_profile(IMAGE))
    heard, done = [], threading.Event()

    def on_twist(message):
        heard.append((message.twist.linear.x, message.twist.angular.z))
        if len(heard) == 1:
            _thread.interrupt_main()

    node.create_subscription(TwistStamped, CMD_VEL.name, on_twist, qos_profile(CMD_VEL))

    def drive():
        number = 0
        while not done.is_set():
            number += 1
            images.publish(fill_image(
                Image(), np.zeros((96, 96, 3), np.uint8), number * 50_000_000, ''))
            executor.spin_once(timeout_sec=0.05)

    car = threading.Thread(target=drive)
    car.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            look(PolicySettings(), (96, 96), namespace=space, remaps={}, seconds=60.0, nudge=True)
        until = time.monotonic() + 10.0
        while heard[-1] != (0.0, 0.0) and time.monotonic() < until:
            time.sleep(0.05)
        assert heard[0] != (0.0, 0.0) and heard[-1] == (0.0, 0.0)
    finally:
        done.set()
        car.join()
        rclpy.try_shutdown(context=node.context)


def claiming(width: int, height: int) -> CompressedImage:
    """Return a png of one pixel that says it is larger."""
    message = fill_compressed_image(CompressedImage(), np.zeros((1, 1, 3), np.uint8), 1, '')
    data = bytes(message.data)
    head = b'IHDR' + struct.pack('>II', width, height) + data[24:29]
    message.data = data[:12] + head + struct.pack('>I', zlib.crc32(head)) + data[33:]
    return message


@pytest.mark.parametrize(('message', 'vehicle', 'sizes', 'verdict', 'told'), [
    (fill_compressed_image(CompressedImage(), view(0), 1, ''), {}, {(96, 96)}, GOOD, '96x96'),
    (fill_compressed_image(CompressedImage(), WORLD, 1, ''), {}, {(240, 160)}, BAD,
     '240x160 is squeezed'),
    (fill_compressed_image(CompressedImage(), view(0), 1, ''), {'camera_crop': '0,0,100,100'},
     {(96, 96)}, BAD, 'camera_crop 0,0,100,100 does not fit'),
    (claiming(60_000, 60_000), {}, set(), BAD, 'no image that can be used'),
    (CompressedImage(data=b'neither'), {}, set(), BAD, 'no image that can be used')])
def test_the_size_of_compressed_images_is_that_of_what_is_in_them(
        message, vehicle, sizes, verdict, told):
    vehicle = {'camera_compressed': True, **vehicle}
    node, executor = node_of_a_command('packing_car', '/packing')
    images = node.create_publisher(CompressedImage, IMAGE.name, qos_profile(IMAGE))
    done = threading.Event()

    def send():
        while not done.is_set():
            images.publish(message)
            executor.spin_once(timeout_sec=0.05)

    car = threading.Thread(target=send)
    car.start()
    try:
        seen = look(from_mapping(PolicySettings, vehicle), (96, 96), namespace='/packing',
                    remaps={}, seconds=0.5, nudge=False)
    finally:
        done.set()
        car.join()
        rclpy.try_shutdown(context=node.context)
    assert seen.sizes == sizes
    size = verdicts(seen, vehicle)['size']
    assert size.verdict == verdict and told in size.found, size


@pytest.mark.parametrize('words', [
    ['run', '--output', 'out'], ['train', '--run', 'out'], ['drive', '--join', '--output', 'out']])
def test_no_command_begins_with_a_vehicle_that_the_policy_does_not_know(
        tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    Path('car.yaml').write_text('simulator: carracing\nvehicle: {linear_skale: 1}')
    assert main([*words, '--simulator', 'car.yaml']) == 2
    error = capsys.readouterr().err
    assert 'car.yaml: vehicle: unknown setting' in error and error.count('\n') == 1
    assert not Path('out').exists()
