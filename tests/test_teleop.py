# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A person drives: keys and joysticks become commands, and the node answers like a policy."""
import os
import pty
import signal
import subprocess
import termios
import time

from carracing_dqn.bringup.processes import node_command
from carracing_dqn.teleop.hand import joined, Joystick, Keyboard, KEYS, LET_GO
from carracing_dqn.teleop.settings import TeleopSettings
from msgs_bridge import topics
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.terminal_keys import DOWN, keys_in, LEFT, RIGHT, UP
from msgs_bridge.twists import Command, STOP
import pytest
from sensor_msgs.msg import Joy

SETTINGS = TeleopSettings()


def test_keys_in_what_terminals_send():
    assert keys_in(b'\x1b[A\x1bOBxa\x1b[Dd \x1b', KEYS) == [UP, DOWN, LEFT, LEFT, RIGHT, LET_GO]
    assert keys_in(bytes(range(256)), KEYS)


def test_a_pedal_stays_and_steering_is_let_go():
    keyboard = Keyboard(SETTINGS)
    for _ in range(7):
        keyboard.press(UP, 0.0)
    assert keyboard.command(100.0) == Command(1.0, 0.0)
    keyboard.press(LEFT, 100.0)
    assert keyboard.command(100.3) == Command(1.0, SETTINGS.key_steering)
    assert keyboard.command(100.5) == Command(1.0, 0.0)
    for _ in range(5):
        keyboard.press(DOWN, 101.0)
    assert keyboard.command(101.0) == STOP
    keyboard.press(RIGHT, 102.0)
    assert keyboard.command(102.0).angular < 0
    keyboard.press(LET_GO, 102.0)
    assert keyboard.command(102.0) == STOP


def test_a_joystick_with_a_dead_zone_a_deadman_and_silence():
    joystick = Joystick(TeleopSettings(deadman_button=1, dead_zone=0.1))
    joystick.take([0.05, 1.0], [0, 1], 0.0)
    assert joystick.command(0.1) == Command(1.0, 0.0)
    joystick.take([-0.55, 0.0], [0, 1], 0.2)
    assert joystick.command(0.2) == Command(0.0, pytest.approx(-0.5))
    joystick.take([-0.55, 0.0], [0, 0], 0.3)
    assert joystick.command(0.3) == STOP
    joystick.take([1.0, 1.0], [0, 1], 0.4)
    assert joystick.command(0.4 + SETTINGS.stale_after + 0.1) == STOP
    for axes, buttons in (([1.0], [0, 1]), ([1.0, float('nan')], [0, 1]), ([1.0, 1.0], [])):
        with pytest.raises(MessageError):
            joystick.take(axes, buttons, 1.0)


def test_of_two_hands_the_larger_counts():
    assert joined(Command(0.2, -0.6), Command(-1.0, 0.1)) == Command(-1.0, -0.6)


def test_a_joystick_drives_a_simulator_in_lockstep(graph):
    graph.listen(topics.IMAGE, topics.CMD_VEL, topics.STEP, topics.DIAGNOSTICS)
    joy = graph.publisher(topics.JOY)
    graph.node('carracing_dqn.teleop.teleop_node', 'teleop', keyboard=False, real_time_factor=4.0)
    graph.node('carracing_sim_node', 'simulator', wait_for_subscribers=1)

    def push():
        joy.publish(Joy(axes=[0.5, 1.0]))
        return len(graph.messages['step']) > 60 and any(
            message.twist.linear.x == 1 for message in graph.messages['cmd_vel'])

    graph.spin_until(push, 90, 'a drive')
    joined_steps, joiner = graph.join()
    assert len(joined_steps) > 40 and not joiner.counts['lost_twist']
    assert joined_steps[-1].command.linear == 1 and joined_steps[-1].command.angular > 0.4
    joy.publish(Joy(axes=[0.5]))
    graph.spin_until(lambda: 'axes' in graph.health('teleop_node').get('summary', ''), 20,
                     'what it lacks')
    graph.spin_until(lambda: graph.messages['cmd_vel'][-1].twist.linear.x == 0, 20, 'it lets go')


def test_any_stamp_is_answered_and_long_frames_are_waited_for(graph):
    graph.listen(topics.CMD_VEL)
    images = graph.publisher(topics.IMAGE)
    child = graph.node('carracing_dqn.teleop.teleop_node', 'teleop_node', real_time_factor=0.01)
    graph.spin_until(images.get_subscription_count, 60, 'the node')
    image = topics_image()

    def answered(second, nanosecond=0):
        image.header.stamp.sec, image.header.stamp.nanosec = second, nanosecond
        count = len(graph.messages['cmd_vel'])
        images.publish(image)
        graph.spin(0.5)
        stamps = [one.header.stamp for one in graph.messages['cmd_vel'][count:]]
        return [(one.sec, one.nanosec) for one in stamps] == [(second, nanosecond)]

    graph.spin_until(lambda: answered(2**31 - 1, 2**32 - 1), 30, 'an answer')
    assert answered(-7, 5) and child.process.poll() is None
    # a second further on may be a new episode; another second is how long frames last
    assert answered(10) and answered(11) and not answered(12)


def test_images_that_come_faster_than_their_time_are_answered_all_the_same(graph):
    """Of a simulator in real time, or a bag, that runs faster than the hands."""
    graph.listen(topics.CMD_VEL)
    images = graph.publisher(topics.IMAGE)
    graph.node('carracing_dqn.teleop.teleop_node', 'teleop_node')
    graph.spin_until(images.get_subscription_count, 60, 'the node')
    image = topics_image()
    for number in range(1, 61):
        image.header.stamp.sec, image.header.stamp.nanosec = divmod(number * 400_000_000, 10**9)
        images.publish(image)
        graph.spin(0.05)
    assert len(graph.messages['cmd_vel']) > 15


def test_keys_of_a_real_terminal_drive_and_the_terminal_is_given_back(graph):
    graph.listen(topics.CMD_VEL)
    images = graph.publisher(topics.IMAGE)
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    process = subprocess.Popen(
        node_command('carracing_dqn.teleop.teleop_node', {}, graph.namespace), stdin=theirs,
        stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT, start_new_session=True,
        preexec_fn=lambda: _take_terminal(theirs))
    try:
        graph.spin_until(images.get_subscription_count, 60, 'the node')
        image = topics_image()
        number = 0

        def typed():
            nonlocal number
            number += 1
            image.header.stamp.sec = number
            images.publish(image)
            os.write(ours, b'\x1b[Aa')
            return any(one.twist.linear.x > 0.5 and one.twist.angular.z > 0.5
                       for one in graph.messages['cmd_vel'])

        graph.spin_until(typed, 30, 'keys that drive')
        assert to_nanoseconds(graph.messages['cmd_vel'][-1].header.stamp) % 10**9 == 0
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert termios.tcgetattr(theirs)[3] == before[3]
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def topics_image():
    from sensor_msgs.msg import Image
    return Image(height=1, width=1, step=3, encoding='rgb8', data=b'\0\0\0')


def _take_terminal(file):
    """Make a terminal the one of a new session."""
    import fcntl
    fcntl.ioctl(file, termios.TIOCSCTTY, 0)
    time.sleep(0)
