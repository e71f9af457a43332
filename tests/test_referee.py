# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The referee: what it makes of what a robot says, without ROS and over real topics."""
import itertools
import math
import subprocess
import sys
import time

from carracing_dqn.simulation.referee import (
    needed_topics, Path, Place, Pose, Referee, yaw_of,
)
from carracing_dqn.simulation.referee_settings import RefereeSettings
from carracing_dqn.simulation.registry import make_simulator
from geometry_msgs.msg import Point, Pose as Pose3, PoseStamped
from msgs_bridge import topics
from msgs_bridge.errors import MessageError, SimulatorError
from msgs_bridge.images import fill_image
from msgs_bridge.named_values import read_named_values
from msgs_bridge.stamps import NANOSECONDS, set_stamp, to_nanoseconds
from msgs_bridge.step import read_step
from msgs_bridge.twists import Command
from nav_msgs.msg import Odometry, Path as NavPath
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float32
from std_srvs.srv import Trigger
import yaml

FRAME = NANOSECONDS // 20
REFEREE = ('carracing_dqn.simulation.referee_node', 'referee_node')


class Robot:
    """Hands what a robot says to a referee, a frame at a time."""

    def __init__(self, *silent, **settings):
        self.referee = Referee(RefereeSettings(**settings))
        self.referee.published = set(self.referee.needed) - set(silent)
        self.stamp, self.now, self.x, self.said = 10 * NANOSECONDS, 100.0, 0.0, []
        self.commands = {}

    def frame(self, ahead=0.1, *, collided=False, lane=None, goal=None, answer=True, odom=True,
              gap=FRAME):
        self.x += ahead
        self.stamp += gap
        self.now += 0.05
        if odom:
            self.referee.hear_odometry(self.stamp, Pose(self.x, 0.0, 0.0))
        if collided:
            self.referee.hear_collision(True)
        for name, value in (('lane_offset', lane), ('goal_distance', goal)):
            if value is not None:
                self.referee.hear_number(name, value, self.now)
        self.referee.see_image(self.stamp, self.now)
        said = self.referee.judge(self.now)
        if answer:
            self.commands[self.stamp] = Command(self.stamp % 7 / 7, 0.0)
            self.referee.hear_twist(self.stamp, self.commands[self.stamp])
        self.said += said
        return said

    @property
    def steps(self):
        return [one.step for one in self.said if one.step is not None]


def test_every_term_gives_what_it_says():
    robot = Robot(forward_weight=2.0, goal_weight=3.0, goal_reward=50.0, goal_radius=1.0,
                  lane_offset_penalty=4.0, collision_penalty=7.0, time_penalty=1.0)
    robot.frame(lane=0.0, goal=5.0)
    robot.frame(0.1, lane=-0.5, goal=4.9)
    robot.frame(-0.2, lane=0.25, goal=5.0, collided=True)
    robot.frame(0.3, lane=0.0, goal=0.9)
    assert [one.reward for one in robot.steps] == pytest.approx([
        0.0, 0.2 + 0.3 - 4 * 0.5 * 0.05 - 0.05, -0.4 - 0.3 - 4 * 0.25 * 0.05 - 7 - 0.05,
        0.6 + 3 * 4.1 + 50 - 0.05])
    assert [one.decision for one in robot.steps] == [0, 1, 2, 3]
    assert [one.ended for one in robot.steps] == [False, False, False, True]
    last = robot.steps[-1]
    assert last.terminated and last.info['goal_reached'] == 1
    assert last.episode_return == pytest.approx(sum(one.reward for one in robot.steps))
    assert robot.said[-1].episode['terminated'] == 1 and robot.said[-1].episode['decisions'] == 3
    # names stay the same for a run, and all that is said is read again
    assert len({tuple(one.info) for one in robot.steps}) == 1
    assert [read_step(one.values()) for one in robot.steps] == robot.steps


def test_the_twist_applied_is_the_one_that_answered_the_frame_before():
    robot = Robot()
    for number in range(5):
        robot.frame(answer=number != 2)
    robot.now += 0.06
    robot.said += robot.referee.judge(robot.now)
    stamps = [one.stamp for one in robot.said]
    assert [one.applied for one in robot.steps] == [
        None, stamps[0], stamps[1], stamps[1], stamps[3]]
    assert [one.info['linear'] for one in robot.steps[1:]] == [
        robot.commands[one.applied].linear for one in robot.steps[1:]]


@pytest.mark.parametrize(('settings', 'frame', 'terminated'), [
    ({'collision_ends': True}, {'collided': True}, True),
    ({'off_lane': 0.5}, {'lane': -0.6}, True),
    ({'goal_radius': 0.5}, {'goal': 0.4}, True),
    ({'time_limit': 0.15}, {}, False)])
def test_an_end_is_told_and_the_next_episode_waits_for_the_reset(settings, frame, terminated):
    robot = Robot(reset_service='reset', **settings)
    usual = {'lane': 0.0, 'goal': 9.0}
    robot.frame(**usual)
    robot.frame(**usual)
    robot.frame(**usual)
    robot.frame(**{**usual, **frame})
    last = robot.steps[-1]
    assert (last.terminated, last.truncated) == (terminated, not terminated)
    assert robot.referee.resetting and not robot.referee.running
    for _ in range(15):
        assert robot.frame(**usual) == []
    robot.referee.reset_done()
    first = robot.frame(**usual)[0]
    assert (first.step.episode, first.step.decision, first.step.reward) == (1, 0, 0.0)
    assert first.episode['decisions'] == 0 and first.episode['contract_version'] == 2


def test_without_a_reset_service_the_next_episode_begins_after_a_gap():
    robot = Robot(time_limit=0.1)
    for _ in range(20):
        robot.frame()
    begun = [one.stamp for one in robot.said if one.step.decision == 0]
    ended = [one.stamp for one in robot.said if one.step.ended]
    assert len(begun) >= 2 and begun[1] - ended[0] == NANOSECONDS // 2


@pytest.mark.parametrize('gap', [NANOSECONDS, -5 * NANOSECONDS])
def test_a_jump_of_the_stamps_cuts_the_episode_off(gap):
    robot = Robot(forward_weight=1.0)
    robot.frame()
    robot.frame()
    cut, first = robot.frame(gap=gap)
    assert cut.step is None and cut.episode['truncated'] == 1 and cut.episode['decisions'] == 1
    assert first.step.episode == 1 and first.step.decision == 0


def test_nothing_is_made_up_for_what_is_missing():
    robot = Robot('lane_offset', forward_weight=1.0, lane_offset_penalty=1.0, off_lane=0.5)
    for _ in range(40):
        assert robot.frame(lane=None) == []
    assert robot.referee.missing == {
        'lane_offset': 'nobody publishes it, lane_offset_penalty, off_lane needs it'}
    assert robot.referee.counts['frames_not_judged'] > 10
    robot.referee.published.add('lane_offset')
    said = [one for _ in range(40) for one in robot.frame(lane=0.1)]
    assert said[0].step.decision == 0
    # odometry stays away for a while: what comes after follows nothing that was judged
    for number in range(60):
        robot.frame(lane=0.1, odom=not 10 <= number < 40)
    decisions = [one.decision for one in robot.steps]
    assert sorted(decisions) == decisions
    assert any(later - sooner > 1 for sooner, later in itertools.pairwise(decisions)) or any(
        one.episode for one in robot.steps)


@pytest.mark.parametrize('missed', [4, 5])
def test_a_collision_at_an_image_that_cannot_be_judged_counts_for_the_next(missed):
    """A crash is when odometry stops, too; the end must not be lost with the frame."""
    robot = Robot(forward_weight=1.0, collision_ends=True, sequence_gap=2.0, input_timeout=0.1)
    for _ in range(3):
        robot.frame()
    for number in range(missed):
        robot.frame(odom=False, collided=number == 0)
    # one of them has been waited for in vain, and perhaps all
    robot.now += 0.1 * (missed - 4)
    robot.said += robot.referee.judge(robot.now)
    assert robot.referee.counts['frames_not_judged'] and not robot.steps[-1].ended
    for _ in range(3):
        robot.frame()
    ended = [one for one in robot.steps if one.ended]
    assert [(one.terminated, one.info['collision']) for one in ended] == [(True, 1.0)]
    assert ended[0].decision > robot.steps[2].decision + 1


def test_a_path_by_other_coordinates_than_odometry_judges_nothing():
    robot = Robot(progress_weight=10.0)
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    for frame_id, judged in (('map', False), ('/odom', True), ('', True), ('map', False)):
        robot.referee.hear_path(line, frame_id)
        robot.referee.hear_odometry(robot.stamp, Pose(robot.x, 0.0, 0.0), 'odom')
        before = len(robot.steps)
        robot.now += 2.0
        robot.stamp += FRAME
        robot.referee.hear_odometry(robot.stamp, Pose(robot.x, 0.0, 0.0), 'odom')
        robot.referee.see_image(robot.stamp, robot.now)
        robot.said += robot.referee.judge(robot.now + 2.0)
        assert (len(robot.steps) > before) == judged
        assert robot.referee.missing == ({} if judged else {
            'path': "it is in the frame 'map', odom in 'odom'; both must be in one"})


def test_odometry_without_an_orientation_heads_nowhere():
    for length in (1e-200, 0.5, 1.0, 3.0):
        half = 0.7
        assert yaw_of(0.0, 0.0, length * math.sin(half), length * math.cos(half)) == (
            pytest.approx(2 * half))
    for odd in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, math.nan, 1.0), (0.0, math.inf, 0.0, 1.0)):
        with pytest.raises(MessageError, match='without an orientation'):
            yaw_of(*odd)


def test_stamps_that_stand_are_counted():
    robot = Robot()
    robot.frame()
    for number in range(12):
        robot.referee.see_image(robot.stamp, robot.now)
        assert robot.referee.again == robot.referee.counts['images_sent_again'] == number + 1
    robot.frame()
    assert robot.referee.again == 0 and robot.referee.counts['images_sent_again'] == 12


def test_a_path_says_how_far_it_went_and_how_far_off():
    angles = np.linspace(0, 2 * math.pi, 100, endpoint=False)
    path = Path(np.stack([5 * np.cos(angles), 5 * np.sin(angles)], 1))
    assert path.closed and path.length == pytest.approx(10 * math.pi, rel=0.01)
    place = path.place(0.0, 4.5)
    assert place.along == pytest.approx(path.length / 4, rel=0.01)
    assert place.offset == pytest.approx(0.5, abs=0.02), 'inside is left of it'
    assert path.gained(Place(path.length - 0.1, 0), Place(0.2, 0)) == pytest.approx(0.3)
    line = Path(np.array([[0.0, 0.0], [4.0, 0.0], [10.0, 0.0]]))
    assert not line.closed and line.place(3.0, -1.0) == (3.0, -1.0)
    robot = Robot(progress_weight=10.0, lane='path', off_lane=0.5)
    robot.referee.hear_path(np.array([[0.0, 0.2], [10.0, 0.2]]))
    robot.frame()
    robot.frame(0.3)
    assert robot.steps[-1].reward == pytest.approx(3.0)
    assert robot.steps[-1].info['lane_offset'] == pytest.approx(-0.2)


def test_what_is_no_number_and_no_path_is_refused():
    referee = Referee(RefereeSettings())
    for points in (np.zeros((1, 2)), np.zeros((5, 2)), np.full((3, 2), math.nan),
                   np.array([[-1e308, 0.0], [1e308, 0.0]]), np.array([[0, 0], [1e-200, 0]])):
        with pytest.raises(MessageError, match='path'):
            referee.hear_path(points)
    with pytest.raises(MessageError, match='lane_offset is nan'):
        referee.hear_number('lane_offset', math.nan, 0.0)
    referee.hear_number('lane_offset', -1.0, 0.0)
    with pytest.raises(MessageError, match='not finite'):
        referee.hear_odometry(0, Pose(math.inf, 0.0, 0.0))


@pytest.mark.parametrize(('settings', 'odd', 'topic'), [
    ({'lane_offset_penalty': 1.0}, {'lane': 1e30}, 'lane_offset'),
    ({'forward_weight': 1.0, 'lane_offset_penalty': 1.0}, {'lane': 0.0, 'ahead': 1e300}, 'odom'),
    ({'goal_weight': 1e6, 'lane_offset_penalty': 1.0}, {'lane': 0.0, 'goal': 1e9},
     'goal_distance')])
def test_a_number_that_cannot_be_spoils_no_more_than_its_frame(settings, odd, topic):
    robot = Robot(**settings)
    usual = {'lane': 0.1, 'goal': 9.0}
    for number in range(10):
        if number == 5:
            assert robot.frame(**{**usual, **odd}) == []
            assert 'cannot be judged by' in robot.referee.missing.pop(topic)
            assert not robot.referee.missing
            robot.x = 0.5
        else:
            robot.frame(**usual)
    assert robot.referee.counts['frames_not_judged'] == 1
    assert [read_step(one.values()) for one in robot.steps] == robot.steps
    # what follows is no successor of what was judged last
    assert [one.decision for one in robot.steps] == [0, 1, 2, 3, 4, 6, 7, 8, 9]


def test_a_distance_below_0_is_no_goal_that_was_reached():
    """By -1 many say that they have no goal."""
    robot = Robot(goal_radius=0.5, goal_reward=50.0)
    robot.frame(goal=9.0)
    with pytest.raises(MessageError, match='goal_distance is -1'):
        robot.frame(goal=-1.0)
    robot.frame(goal=8.9)
    assert [one.reward for one in robot.steps] == [0.0, 0.0] and not robot.steps[-1].ended


def test_terms_that_are_off_need_no_topic():
    assert needed_topics(RefereeSettings()) == {}
    assert needed_topics(RefereeSettings(collision_ends=True)) == {'collision': 'collision_ends'}


@pytest.mark.parametrize(('parameter', 'told'), [
    ('collision_penalty:=-1.0', 'collision_penalty is -1.0; accepted: 0'),
    ('goal_reward:=50.0', 'goal_reward is 50, which nothing earns while goal_radius is 0'),
    ('lane:=line', "lane is 'line'"), ('colision_ends:=true', "did you mean 'collision_ends'"),
    ("reset_service:='no name!'", 'reset_service')])
def test_a_parameter_that_is_none_ends_the_node_with_one_line(parameter, told):
    result = subprocess.run(
        [sys.executable, '-m', REFEREE[0], '--ros-args', '-p', parameter],
        capture_output=True, text=True, timeout=60)
    errors = [line for line in result.stderr.splitlines() if line.startswith('error: ')]
    assert result.returncode == 2 and len(errors) == 1 and told in errors[0], result.stderr
    assert 'Traceback' not in result.stderr


def test_over_topics_a_robot_is_judged_and_bad_input_counted(graph):
    """A robot of the test's own: frames without answers, a flag, and a service that refuses."""
    graph.listen(topics.STEP, topics.EPISODE, topics.DIAGNOSTICS)
    images, odometry = graph.publisher(topics.IMAGE), graph.publisher(topics.ODOMETRY)
    lane, collisions = graph.publisher(topics.LANE_OFFSET), graph.publisher(topics.COLLISION)
    asked = []

    def reset(_, response):
        asked.append(len(asked))
        response.success = len(asked) > 1
        return response

    graph.probe.create_service(Trigger, 'robot/reset', reset)
    graph.node(*REFEREE, forward_weight=1.0, lane_offset_penalty=1.0, collision_ends=True,
               reset_service='robot/reset', reset_retry=0.2, goal_weight=0.0, sequence_gap=0.3)
    graph.spin_until(lambda: all(one.get_subscription_count() for one in (
        images, odometry, lane, collisions)), 20, 'the referee hears')
    graph.spin(0.5)
    numbers = itertools.count(1)

    def frame(ahead=0.1, collided=False, offset=0.2):
        number = next(numbers)
        place = Odometry()
        set_stamp(place.header.stamp, number * FRAME)
        place.pose.pose.position.x, place.pose.pose.orientation.w = number * ahead, 1.0
        odometry.publish(place)
        lane.publish(Float32(data=offset))
        collisions.publish(Bool(data=collided))
        images.publish(fill_image(Image(), np.zeros((4, 4, 3), np.uint8), number * FRAME, 'c'))
        graph.spin(0.03)

    for _ in range(10):
        frame()
    lane.publish(Float32(data=math.nan))
    frame(collided=True)
    graph.spin_until(lambda: len(graph.messages['episode']) == 2, 5, 'the end')
    graph.spin_until(lambda: len(asked) == 2, 5, 'the reset is asked for again')
    graph.spin(0.1)
    for _ in range(10):
        frame()
    graph.spin_until(lambda: len(graph.messages['episode']) == 3, 5, 'the next episode')
    steps = [read_step(read_named_values(message)) for message in graph.messages['step']]
    first = [one for one in steps if one.episode == 0]
    assert [one.decision for one in first] == list(range(11))
    assert [one.reward for one in first[1:]] == pytest.approx([0.1 - 0.2 * 0.05] * 10, abs=1e-6)
    assert first[-1].terminated and all(one.applied is None for one in first)
    graph.spin_until(lambda: graph.health('referee_node').get('rejected_lane_offset') == '1', 5,
                     'what is no number is counted')


def test_a_topic_that_nobody_publishes_is_named(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    images = graph.publisher(topics.IMAGE)
    child = graph.node(*REFEREE, goal_weight=1.0, time_limit=1.0)
    graph.spin_until(images.get_subscription_count, 20, 'the referee hears')
    for number in range(1, 30):
        images.publish(fill_image(Image(), np.zeros((4, 4, 3), np.uint8), number * FRAME, 'c'))
        graph.spin(0.05)
    told = 'goal_distance: nobody publishes it, goal_weight needs it'
    graph.spin_until(lambda: told in graph.health('referee_node').get('summary', ''), 5, 'told')
    assert child.said(told) and not graph.messages['step']


def test_stamps_that_say_no_time_are_counted_and_told(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    images = graph.publisher(topics.IMAGE)
    child = graph.node(*REFEREE)
    graph.spin_until(images.get_subscription_count, 60, 'the referee hears')
    message = fill_image(Image(), np.zeros((4, 4, 3), np.uint8), 0, 'c')
    for second, nanosecond in ((0, 0), (2**31 - 1, 2**32 - 1), (-5, 0)):
        message.header.stamp.sec, message.header.stamp.nanosec = second, nanosecond
        images.publish(message)
    graph.spin_until(lambda: graph.health('referee_node').get('rejected_image_raw') == '3', 20,
                     'all are counted')
    assert child.said('an image without a stamp') and child.process.poll() is None
    # and a camera whose stamps stand is named
    for _ in range(15):
        images.publish(fill_image(message, np.zeros((4, 4, 3), np.uint8), FRAME, 'c'))
        graph.spin(0.02)
    graph.spin_until(lambda: 'images in a row bear one stamp' in graph.health(
        'referee_node').get('summary', ''), 20, 'told')
    assert len(graph.messages['step']) == 1


def test_long_paths_many_times_a_second_leave_time_to_judge(graph):
    graph.listen(topics.STEP)
    images, odometry, paths = map(graph.publisher, (topics.IMAGE, topics.ODOMETRY, topics.PATH))
    graph.node(*REFEREE, progress_weight=10.0)
    graph.spin_until(lambda: all(one.get_subscription_count() for one in (
        images, odometry, paths)), 60, 'the referee hears')
    graph.spin(0.5)
    path = serialize_message(NavPath(poses=[
        PoseStamped(pose=Pose3(position=Point(x=number / 10))) for number in range(3000)]))
    begun = time.monotonic()
    for number in range(1, 101):
        stamp = number * FRAME
        place = Odometry()
        set_stamp(place.header.stamp, stamp)
        place.pose.pose.position.x, place.pose.pose.orientation.w = number / 10, 1.0
        odometry.publish(place)
        paths.publish(path)
        images.publish(fill_image(Image(), np.zeros((4, 4, 3), np.uint8), stamp, 'c'))
        graph.spin(max(0.0, begun + number / 20 - time.monotonic()))
    assert len(graph.messages['step']) > 60


def test_a_camera_that_falls_silent_is_told(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    graph.node(*REFEREE)

    def told(text):
        graph.spin_until(lambda: text in graph.health('referee_node').get('summary', ''), 20, text)

    told(f'no image: nobody publishes /{graph.namespace}/image_raw')
    images = graph.publisher(topics.IMAGE)
    numbers = itertools.count(1)

    def judged():
        images.publish(fill_image(
            Image(), np.zeros((4, 4, 3), np.uint8), next(numbers) * FRAME, 'c'))
        return graph.health('referee_node').get('summary') == 'judging'

    graph.spin_until(judged, 20, 'it judges')
    told('no image for')


def test_a_camera_that_is_slower_than_the_gap_is_told(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    images = graph.publisher(topics.IMAGE)
    graph.node(*REFEREE)
    graph.spin_until(images.get_subscription_count, 60, 'the referee hears')
    numbers = itertools.count(1)

    def told():
        stamp = next(numbers) * NANOSECONDS
        images.publish(fill_image(Image(), np.zeros((4, 4, 3), np.uint8), stamp, 'c'))
        return 'sequence_gap, 0.5 s' in graph.health('referee_node').get('summary', '')

    graph.spin_until(told, 20, 'what cuts them off')
    # once it is judged nothing is said any more
    robot = Robot()
    for _ in range(5):
        robot.frame(gap=NANOSECONDS)
    assert robot.referee.jumps == 4
    robot.frame()
    assert robot.referee.jumps == 0


@pytest.fixture
def mujoco():
    try:
        simulator = make_simulator('mujoco_robot')
    except SimulatorError as error:
        pytest.skip(str(error))
    yield simulator
    simulator.close()


def test_mujocos_car_as_a_robot_without_a_reward_is_judged_frame_by_frame(graph, mujoco):
    heard = (topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.EPISODE, topics.ODOMETRY,
             topics.COLLISION)
    graph.listen(*heard)
    space = f'/{graph.namespace}'
    graph.node(*REFEREE, forward_weight=10.0, collision_penalty=5.0, collision_ends=True,
               time_limit=3.0, reset_service='mujoco_robot_node/reset', wait_for_subscribers=1)
    graph.node('dqn_policy_node', 'dqn_policy_node', model='random', wait_for_subscribers=3)
    graph.node('carracing_dqn.simulators.mujoco_robot_node', 'mujoco_robot_node', seed=3,
               seed_each_episode=True, wait_for_subscribers=2)
    graph.spin_until(lambda: len(graph.messages['episode']) >= 7, 90, 'three episodes')
    publishers = graph.probe.get_publishers_info_by_topic(f'{space}/step')
    assert {one.node_name for one in publishers} == {'referee_node'}, 'the robot has no reward'
    joined, joiner = graph.join()
    # three seconds of 50 ms each, the reset frame beside
    assert len(joined) >= 170
    assert not joiner.counts['lost_step'] + joiner.counts['unanswered']
    poses = {to_nanoseconds(one.header.stamp): one.pose.pose for one in graph.messages['odom']}
    for one in joined:
        before, after = poses[one.stamp], poses[one.next_stamp]
        yaw = 2 * math.atan2(before.orientation.z, before.orientation.w)
        ahead = ((after.position.x - before.position.x) * math.cos(yaw)
                 + (after.position.y - before.position.y) * math.sin(yaw))
        assert one.step.info['ahead'] == pytest.approx(ahead, abs=1e-9)
        assert one.step.reward == pytest.approx(
            10 * ahead - 5 * one.step.info['collision'], abs=1e-9)
        assert one.command == (one.step.info['linear'], one.step.info['angular'])
        assert one.stamp == one.step.applied and one.next_stamp - one.stamp == FRAME
    # every episode is a track of its own, from its start, and its frames are the car's own
    for episode in range(3):
        drive = [one for one in joined if one.step.episode == episode]
        assert [one.step.decision for one in drive] == list(range(1, len(drive) + 1))
        assert drive[-1].step.ended
    first = [one for one in joined if one.step.episode == 0]
    outcome = mujoco.reset(3)
    for one in first:
        assert np.array_equal(one.frame, outcome.pixels)
        outcome = mujoco.advance(one.command)
        assert np.array_equal(one.next_frame, outcome.pixels)


LEARNING = {
    'simulator': 'mujoco_robot', 'frame_height': 96, 'frame_width': 96, 'frame_seconds': 0.05,
    'action_repeat': 1, 'convolutions': '4@8/4 8@4/2', 'hidden': 16, 'learning_starts': 40,
    'replay_capacity': 1000, 'weights_every': 20, 'validation_every_episodes': 0,
    'run_episodes': 0, 'run_decisions': 150,
}


def test_the_trainer_learns_from_what_the_referee_says(graph, mujoco, tmp_path):
    preset = tmp_path / 'robot.yaml'
    preset.write_text(yaml.safe_dump(LEARNING))
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    trainer = graph.node(
        'trainer_node', 'trainer_node', run=str(tmp_path / 'run'), preset=str(preset),
        simulator='mujoco_robot_node', last_validation_seconds=0.0)
    graph.node(*REFEREE, forward_weight=10.0, progress_weight=5.0, lane='path', off_lane=1.0,
               collision_penalty=5.0, time_limit=2.0, reset_service='mujoco_robot_node/reset',
               wait_for_subscribers=2)
    graph.node('dqn_policy_node', 'dqn_policy_node', model='', explore=True,
               wait_for_subscribers=3)
    graph.node('carracing_dqn.simulators.mujoco_robot_node', 'mujoco_robot_node',
               publish_path=True, wait_for_subscribers=2)
    graph.spin_until(lambda: trainer.process.poll() is not None, 90, 'the run ends')
    assert trainer.process.returncode == 0, list(trainer.words)
    rows = (tmp_path / 'run' / 'episodes.csv').read_text().splitlines()
    assert len(rows) > 2 and (tmp_path / 'run' / 'final').is_dir()
    steps = [read_step(read_named_values(message)) for message in graph.messages['step']]
    assert {'ahead', 'gained', 'lane_offset', 'collision'} <= set(steps[0].info)
