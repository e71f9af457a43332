# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A person drives: keys and joysticks become commands, and the node answers like a policy."""
import contextlib
import fcntl
import itertools
import os
import pty
import signal
import subprocess
import termios
import types

from carracing_dqn.bringup.processes import node_command
from carracing_dqn.teleop.hand import joined, Joystick, Keyboard, KEYS, LET_GO
from carracing_dqn.teleop.settings import TeleopSettings
from geometry_msgs.msg import Twist
from msgs_bridge import topics
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.terminal_keys import DOWN, keys_in, LEFT, RIGHT, UP
from msgs_bridge.twists import Command, STOP
import pytest
from sensor_msgs.msg import Joy
from std_srvs.srv import SetBool

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


@pytest.fixture
def at_a_terminal(graph):
    """Start the node at a terminal of its own; return how to send it an image, and what it is."""
    graph.listen(topics.CMD_VEL)
    images = graph.publisher(topics.IMAGE)
    with contextlib.ExitStack() as stack:
        ours, theirs = pty.openpty()
        # a test may close its own end
        stack.callback(lambda: [os.close(one) for one in (ours, theirs) if _is_open(one)])

        def start(*, ignores_hangup=False):
            process = subprocess.Popen(
                node_command('carracing_dqn.teleop.teleop_node', {}, graph.namespace),
                stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=lambda: _take_terminal(theirs, ignores_hangup=ignores_hangup))
            stack.callback(process.wait)
            stack.callback(process.kill)
            graph.spin_until(images.get_subscription_count, 60, 'the node')
            return process

        image, seconds = topics_image(), itertools.count(1)

        def show():
            image.header.stamp.sec = next(seconds)
            images.publish(image)

        def drive():
            show()
            os.write(ours, b'\x1b[Aa')
            return any(one.twist.linear.x > 0.5 and one.twist.angular.z > 0.5
                       for one in graph.messages['cmd_vel'])

        yield types.SimpleNamespace(start=start, show=show, drive=drive, ends=(ours, theirs))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_keys_of_a_real_terminal_drive_and_at_the_end_the_car_stands(graph, at_a_terminal, number):
    before = termios.tcgetattr(at_a_terminal.ends[1])
    process = at_a_terminal.start()
    graph.spin_until(at_a_terminal.drive, 30, 'keys that drive')
    assert to_nanoseconds(graph.messages['cmd_vel'][-1].header.stamp) % 10**9 == 0
    process.send_signal(number)
    assert process.wait(20) == 0
    assert termios.tcgetattr(at_a_terminal.ends[1])[3] == before[3]
    graph.spin(0.5)
    last = graph.messages['cmd_vel'][-1]
    assert last.twist == Twist() and to_nanoseconds(last.header.stamp) == 0


def test_keys_of_a_terminal_that_has_gone_count_as_let_go(graph, at_a_terminal):
    process = at_a_terminal.start(ignores_hangup=True)
    graph.spin_until(at_a_terminal.drive, 30, 'keys that drive')
    for one in at_a_terminal.ends:
        os.close(one)

    def stands():
        at_a_terminal.show()
        last = graph.messages['cmd_vel'][-1]
        return last.header.stamp.sec and last.twist == Twist()

    graph.spin_until(stands, 20, 'it lets go')
    assert process.poll() is None


def test_when_no_image_comes_and_when_it_is_disabled_the_pedal_does_not_stay(graph, at_a_terminal):
    at_a_terminal.start()
    graph.spin_until(at_a_terminal.drive, 30, 'keys that drive')

    def stopped():
        last = graph.messages['cmd_vel'][-1]
        return last.twist == Twist() and to_nanoseconds(last.header.stamp) == 0

    graph.spin_until(stopped, 20, 'a stop without images')
    count = len(graph.messages['cmd_vel'])
    graph.spin(3)
    assert len(graph.messages['cmd_vel']) == count
    enable = graph.probe.create_client(SetBool, 'teleop_node/enable')
    graph.spin_until(enable.service_is_ready, 20, 'the service')
    for enabled in (False, True):
        answer = enable.call_async(SetBool.Request(data=enabled))
        graph.spin_until(answer.done, 20, 'an answer')
    count = len(graph.messages['cmd_vel'])
    at_a_terminal.show()
    graph.spin_until(lambda: len(graph.messages['cmd_vel']) > count, 20, 'an answer')
    assert graph.messages['cmd_vel'][-1].twist == Twist()


def topics_image():
    from sensor_msgs.msg import Image
    return Image(height=1, width=1, step=3, encoding='rgb8', data=b'\0\0\0')


def _is_open(file):
    with contextlib.suppress(OSError):
        return bool(os.fstat(file))
    return False


def _take_terminal(file, *, ignores_hangup):
    """Make a terminal the one of a new session."""
    if ignores_hangup:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    fcntl.ioctl(file, termios.TIOCSCTTY, 0)
