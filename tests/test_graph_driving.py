# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and policy as real processes over real DDS."""
import signal
import sys

from carracing_dqn.bringup.processes import node_command
from carracing_sim_node import make_env
from carracing_sim_node.controls import controls
from dqn_policy_node.action_space import ACTION_SPACES
from dqn_policy_node.model_description import ModelDescription
from dqn_policy_node.network import QNetwork
from dqn_policy_node.weights_message import encode_weights
from geometry_msgs.msg import Twist, TwistStamped
from graph_probe import kill, ROOT
from msgs_bridge import topics
from msgs_bridge.images import fill_image
from msgs_bridge.stamps import set_stamp, to_nanoseconds
import numpy as np
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger
import torch
from trainer_node.hyperparameters import Hyperparameters

SIM = ('carracing_sim_node', 'carracing_sim_node')
POLICY = ('dqn_policy_node', 'dqn_policy_node')


def call(graph, service_type, name, request, seconds=5):
    client = graph.probe.create_client(service_type, name)
    graph.spin_until(client.service_is_ready, seconds, f'{name} is there')
    future = client.call_async(request)
    graph.spin_until(future.done, seconds, f'{name} answers')
    return future.result()


def test_every_transition_of_a_lockstep_drive_arrives_once_and_is_what_the_simulator_did(graph):
    graph.listen(topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.EPISODE)
    graph.node(*POLICY, model='random', wait_for_subscribers=2)
    graph.node(*SIM, action_repeat=4, max_episode_frames=120, episodes=3, seed=7,
               seed_each_episode=True, wait_for_subscribers=1)
    # each begins and ends
    graph.spin_until(lambda: len(graph.messages['episode']) == 6, 30, 'three episodes')
    graph.spin(0.3)
    joined, joiner = graph.join()
    assert len(joined) == 3 * 30
    # a frame may have been sent again while the connections were made; nothing else may differ
    counts = {name: n for name, n in joiner.counts.items() if n and name != 'duplicate'}
    assert counts == {'joined': 90}
    assert len({t.stamp for t in joined}) == 90
    # the same actions in the same environment without any ROS
    env = make_env(action_repeat=4, max_episode_steps=120)
    for episode in range(3):
        frame, _ = env.reset(seed=7 + episode)
        for transition in joined[30 * episode:30 * episode + 30]:
            assert np.array_equal(transition.frame, frame)
            frame, reward, terminated, truncated, _ = env.step(controls(transition.command))
            assert np.array_equal(transition.next_frame, frame)
            assert transition.step.reward == reward
            assert (transition.terminated, transition.truncated) == (terminated, truncated)
        assert truncated


def test_weights_from_a_topic_change_what_the_policy_does_and_bad_ones_do_not(graph):
    graph.listen(topics.CMD_VEL, topics.DIAGNOSTICS, topics.Q_VALUES)
    weights, images = graph.publisher(topics.WEIGHTS), graph.publisher(topics.IMAGE)
    graph.node(*POLICY, model='')
    description = Hyperparameters(convolutions='8@8/4 8@4/2', hidden=16).model_description()
    names = ACTION_SPACES['seed5'].names
    stamp = 0

    def publish(best, version, damage=False):
        network = QNetwork(description)
        tensors = {name: tensor * 0 for name, tensor in network.state_dict().items()}
        last = [name for name in tensors if name.endswith('bias')][-1]
        tensors[last][best] = 1.0
        data = bytearray(encode_weights(tensors, description, version=version))
        if damage:
            data[-1] ^= 1
        weights.publish(UInt8MultiArray(data=data))

    def drive():
        nonlocal stamp
        stamp += 20_000_000
        before = len(graph.messages['q_values'])
        pixels = np.zeros((96, 96, 3), np.uint8)
        images.publish(fill_image(Image(), pixels, stamp, 'camera'))
        graph.spin_until(lambda: len(graph.messages['q_values']) > before, 10, 'an answer')
        values = dict(zip(graph.messages['q_values'][-1].name,
                          graph.messages['q_values'][-1].position))
        return names[int(values['chosen'])], values['weights_version']

    assert isinstance(description, ModelDescription)
    graph.spin_until(lambda: weights.get_subscription_count() == 1
                     and images.get_subscription_count() == 1, 20, 'the policy is there')
    publish(best=1, version=1)
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('weights_version') == '1',
                     10, 'version 1 arrives')
    assert drive() == (names[1], 1)
    publish(best=3, version=2)
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('weights_version') == '2',
                     10, 'version 2 arrives')
    assert drive() == (names[3], 2)
    publish(best=4, version=3, damage=True)
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('rejected_weights') == '1',
                     10, 'the damaged version is counted')
    assert drive() == (names[3], 2)


@pytest.mark.parametrize('change', [
    {'encoding': 'mono16'}, {'data': b'1'}, {'step': 5}])
def test_images_that_cannot_be_used_are_counted_and_the_policy_goes_on(graph, change):
    graph.listen(topics.CMD_VEL, topics.DIAGNOSTICS)
    images = graph.publisher(topics.IMAGE)
    # the model of the report at its first weights: it takes 96x96 frames
    graph.node(*POLICY, model='')
    weights = graph.publisher(topics.WEIGHTS)
    description = Hyperparameters(convolutions='8@8/4', hidden=16).model_description()
    weights.publish(UInt8MultiArray(data=encode_weights(
        QNetwork(description).state_dict(), description, version=1)))
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('weights_version') == '1',
                     20, 'weights arrive')
    bad = fill_image(Image(), np.zeros((96, 96, 3), np.uint8), 10**9, 'camera')
    for name, value in change.items():
        setattr(bad, name, value)
    images.publish(bad)
    graph.spin_until(lambda: graph.health('dqn_policy_node').get('rejected_image_raw') == '1',
                     10, 'the bad image is counted')
    assert not graph.messages['cmd_vel']
    images.publish(fill_image(Image(), np.zeros((96, 96, 3), np.uint8), 2 * 10**9, 'camera'))
    graph.spin_until(lambda: graph.messages['cmd_vel'], 10, 'the good image is answered')


def twist(stamp, forward=0.0, left=0.0):
    message = TwistStamped()
    set_stamp(message.header.stamp, stamp)
    message.twist.linear.x, message.twist.angular.z = forward, left
    return message


def test_twists_that_cannot_be_used_do_not_move_the_car(graph):
    # the simulator waits for a subscription of image_raw, so that is the last to be announced
    graph.listen(topics.STEP, topics.DIAGNOSTICS, topics.IMAGE)
    twists = graph.publisher(topics.CMD_VEL)
    graph.node(*SIM, answer_timeout=60.0)
    graph.spin_until(lambda: graph.messages['step'], 20, 'the first frame')
    stamp = to_nanoseconds(graph.messages['step'][0].header.stamp)
    twists.publish(twist(stamp, forward=float('nan')))
    twists.publish(twist(stamp + 20_000_000, forward=1.0))
    graph.spin_until(lambda: graph.health('carracing_sim_node').get('rejected_cmd_vel') == '2',
                     10, 'a NaN and a stale twist are counted')
    assert len(graph.messages['step']) == 1
    twists.publish(twist(stamp, forward=3.0, left=-9.0))
    graph.spin_until(lambda: len(graph.messages['step']) == 2, 10, 'the good twist is answered')
    facts = dict(zip(graph.messages['step'][1].name, graph.messages['step'][1].position))
    assert (facts['linear'], facts['angular']) == (1.0, -1.0)
    graph.spin_until(lambda: graph.health('carracing_sim_node').get('clamped_twists') == '1',
                     10, 'the clamped twist is counted')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize('fast_transport', [True, False])
def test_a_policy_that_is_ended_lets_the_car_stand(graph, number, fast_transport):
    """A robot may hold the last twist for good."""
    graph.listen(topics.CMD_VEL)
    images = graph.publisher(topics.IMAGE)
    policy = graph.node(*POLICY, model='random', fast_transport=fast_transport)
    twists = graph.messages['cmd_vel']
    stamp = 0

    def drive():
        nonlocal stamp
        stamp += 80_000_000
        images.publish(fill_image(Image(), np.zeros((96, 96, 3), np.uint8), stamp, 'camera'))
        return len(twists) > 20

    graph.spin_until(drive, 30, 'it drives')
    policy.signal(number)
    graph.spin_until(lambda: not to_nanoseconds(twists[-1].header.stamp), 10, 'a last twist')
    graph.spin_until(lambda: policy.code is not None, 10, 'its end')
    graph.spin(0.2)
    last = twists[-1]
    assert last.header.stamp == type(last.header.stamp)() and last.twist == type(last.twist)()
    assert policy.code in (0, 130)


def test_the_simulator_outlives_its_policy(graph):
    graph.listen(topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.DIAGNOSTICS)
    # simulator and probe: what we do not hear would count as lost
    policy = graph.node(*POLICY, model='random', wait_for_subscribers=2)
    simulator = graph.node(*SIM, answer_timeout=0.3)
    graph.spin_until(lambda: len(graph.messages['step']) > 50, 30, 'driving')
    kill(policy)
    del graph.children['dqn_policy_node']
    graph.spin_until(lambda: simulator.said('no twist on cmd_vel has answered'), 10, 'a warning')
    graph.spin(0.5)
    count = len(graph.messages['step'])
    graph.spin(1.0)
    assert len(graph.messages['step']) == count
    assert simulator.code is None
    graph.node(*POLICY, model='random', wait_for_subscribers=2)
    graph.spin_until(lambda: len(graph.messages['step']) > count + 50, 30, 'driving on')
    joined, joiner = graph.join()
    # nothing of the episode was lost, because the frame was sent again
    assert joiner.counts['unanswered'] == 0 and joiner.counts['lost_twist'] == 0
    assert len(joined) >= count - 5


def test_pause_step_and_reset(graph):
    graph.listen(topics.STEP, topics.IMAGE)
    graph.node(*POLICY, model='random')
    graph.node(*SIM, start_paused=True, wait_for_subscribers=1)
    graph.spin_until(lambda: len(graph.messages['step']) == 1, 30, 'the first frame')
    graph.spin(0.5)
    assert len(graph.messages['step']) == 1
    assert call(graph, Trigger, 'carracing_sim_node/step', Trigger.Request()).success
    graph.spin_until(lambda: len(graph.messages['step']) == 2, 5, 'one step')
    graph.spin(0.3)
    assert len(graph.messages['step']) == 2
    assert call(graph, Trigger, 'carracing_sim_node/reset', Trigger.Request()).success
    graph.spin_until(lambda: len(graph.messages['step']) == 3, 5, 'a reset')
    facts = dict(zip(graph.messages['step'][2].name, graph.messages['step'][2].position))
    assert (facts['episode'], facts['decision']) == (1, 0)
    assert call(graph, SetBool, 'carracing_sim_node/pause', SetBool.Request(data=False)).success
    graph.spin_until(lambda: len(graph.messages['step']) > 20, 10, 'driving')
    refused = call(graph, Trigger, 'carracing_sim_node/step', Trigger.Request())
    assert not refused.success and 'not paused' in refused.message
    stamps = [to_nanoseconds(message.header.stamp) for message in graph.messages['step']]
    assert stamps == sorted(set(stamps))


def test_holding_back_and_pausing_do_not_undo_each_other(graph):
    graph.listen(topics.STEP)
    graph.node(*POLICY, model='random')
    graph.node(*SIM, start_paused=True)
    graph.spin_until(lambda: len(graph.messages['step']) == 1, 30, 'the first frame')

    def say(service, value):
        assert call(graph, SetBool, f'carracing_sim_node/{service}',
                    SetBool.Request(data=value)).success
        graph.spin(0.3)

    for service, value in (('hold', True), ('hold', False), ('hold', True), ('pause', False)):
        say(service, value)
        assert len(graph.messages['step']) == 1
    say('hold', False)
    assert len(graph.messages['step']) > 1


def test_a_learner_that_dies_does_not_hold_the_car_for_ever(graph):
    graph.listen(topics.STEP)
    graph.node(*POLICY, model='random')
    graph.node(*SIM)
    graph.spin_until(lambda: len(graph.messages['step']) > 10, 30, 'driving')
    hold = graph.probe.create_client(SetBool, 'carracing_sim_node/hold')
    graph.spin_until(hold.service_is_ready, 5, 'hold is there')
    future = hold.call_async(SetBool.Request(data=True))
    graph.spin_until(future.done, 5, 'hold answers')
    graph.spin(0.3)
    count = len(graph.messages['step'])
    graph.probe.destroy_client(hold)
    graph.spin_until(lambda: len(graph.messages['step']) > count + 10, 10, 'driving on')


def test_real_time_runs_by_the_wall_clock_and_lets_go_of_a_stale_twist(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    twists = graph.publisher(topics.CMD_VEL)
    graph.node(*SIM, stepping='real_time', stale_after=0.2)
    graph.spin_until(lambda: graph.messages['step'], 20, 'the first frame')
    twists.publish(twist(to_nanoseconds(graph.messages['step'][-1].header.stamp), forward=1.0))
    graph.spin_until(
        lambda: graph.health('carracing_sim_node').get('stale_twists') == '1', 10, 'stale')
    gas = [dict(zip(m.name, m.position))['linear'] for m in graph.messages['step']]
    assert max(gas) == 1.0 and gas[-1] == 0.0
    assert 5 <= sum(g > 0 for g in gas) <= 20


def test_plain_twists_drive_too_whatever_the_topic_is_called(graph):
    graph.listen(topics.STEP)
    for (module, name), parameters in ((POLICY, {'model': 'random'}), (SIM, {})):
        graph.start(name, [
            *node_command(module, {'cmd_vel_stamped': False, **parameters}, graph.namespace),
            '-r', 'cmd_vel:=wheels/twist'])
    graph.spin_until(lambda: len(graph.messages['step']) > 30, 30, 'driving')


@pytest.mark.parametrize('parameters, words', [
    ({'stepping': 'lokstep'}, "accepted: one of 'lockstep', 'real_time'"),
    ({'action_repeat': 0}, 'accepted: 1 to 50'),
    ({'action_repat': 4}, "did you mean 'action_repeat'"),
    ({'seed': 'seven'}, 'seed must be a whole number'),
])
def test_parameters_that_are_not_accepted_end_the_node_with_one_line(graph, parameters, words):
    child = graph.node(*SIM, **parameters)
    assert child.process.wait(20) == 2
    child._reader.join(2)
    lines = [line for line in child.words if line.startswith('error: ')]
    assert len(lines) == 1 and words in lines[0]


def test_a_robot_that_has_never_heard_of_us_is_driven_by_remaps_and_parameters_alone(graph):
    twists = []
    graph.probe.create_subscription(Twist, 'base/command', twists.append, 100)
    graph.listen(topics.DIAGNOSTICS)
    parameters = {
        'cmd_vel_stamped': False, 'linear_scale': 0.4, 'linear_offset': 0.4,
        'linear_low': 0.0, 'linear_high': 0.8, 'linear_rate': 1.0, 'angular_scale': 1.5,
        'angular_rate': 6.0, 'camera_crop': '80,0,480,480', 'stale_after': 0.5}
    graph.start('dqn_policy_node', [
        *node_command('dqn_policy_node', parameters, graph.namespace),
        '-r', 'image_raw:=front/image', '-r', 'cmd_vel:=base/command'])

    def summary(words, seconds=20):
        graph.spin_until(
            lambda: words in graph.health('dqn_policy_node').get('summary', ''), seconds, words)

    summary('nobody publishes /')
    robot = graph.start('robot', [
        sys.executable, str(ROOT / 'tests/foreign_camera.py'), '--ros-args', '-r',
        f'__ns:=/{graph.namespace}'])
    graph.spin_until(lambda: len(twists) > 60, 30, 'driven')
    summary('driving')
    speeds = np.array([twist.linear.x for twist in twists])
    turns = np.array([twist.angular.z for twist in twists])
    assert speeds.min() >= 0 and speeds.max() <= 0.8 and abs(turns).max() <= 1.5
    # it starts from a stand, at most so fast
    assert speeds[0] <= 0.1 and np.diff(speeds[:10]).max() < 0.2
    # who is disabled stops once and says nothing more
    assert call(graph, SetBool, 'dqn_policy_node/enable', SetBool.Request(data=False)).success
    summary('disabled')
    count = len(twists)
    graph.spin(0.5)
    assert twists[-1] == Twist() and len(twists) == count
    assert call(graph, SetBool, 'dqn_policy_node/enable', SetBool.Request(data=True)).success
    graph.spin_until(lambda: len(twists) > count + 10, 10, 'driven again')
    assert robot.code is None
    kill(robot)
    del graph.children['robot']
    summary('stopped: no image')
    assert twists[-1] == Twist()
    # on a busy machine images are late before, too
    assert int(graph.health('dqn_policy_node')['stale_images']) >= 1


@pytest.mark.parametrize('parameters, words', [
    ({'device': 'cuda'}, "device is 'cuda', which cannot be used here"),
    ({'camera_crop': '1,2'}, 'LEFT,TOP,WIDTH,HEIGHT'),
    ({'linear_low': 2.0, 'linear_high': 1.0}, 'linear_low is 2.0'),
])
def test_parameters_of_the_policy_that_cannot_be_are_one_line(graph, parameters, words):
    if parameters.get('device') == 'cuda' and torch.cuda.is_available():
        pytest.skip('there is one')
    child = graph.node(*POLICY, **parameters)
    assert child.process.wait(60) == 2
    child._reader.join(2)
    assert [line for line in child.words if line.startswith('error: ') and words in line]
    assert not any('Traceback' in line for line in child.words)


def test_a_missing_model_is_named(graph):
    child = graph.node(*POLICY, model='no_such_model')
    assert child.process.wait(60) == 2
    child._reader.join(2)
    assert any("'no_such_model'" in line for line in child.words)
