# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The node around any simulator, as a process over real DDS."""
import itertools
from pathlib import Path
import signal
import sys
import time

from carracing_dqn.bringup.processes import node_command
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.policies import PolicySource
from carracing_dqn.simulation import open_drive
from geometry_msgs.msg import Twist, TwistStamped
from graph_probe import carracing
from msgs_bridge import topics
from msgs_bridge.named_values import read_named_values
from msgs_bridge.stamps import set_stamp, to_nanoseconds
from msgs_bridge.step import read_step
import numpy as np
import pytest
from sensor_msgs.msg import Image, JointState
from std_srvs.srv import SetBool, Trigger
import yaml

SIM = ('carracing_sim_node', 'carracing_sim_node')
POLICY = ('dqn_policy_node', 'dqn_policy_node')
TOY = 'toy_simulator:Toy'
FAILING = """
import time

from carracing_sim_node.simulator import CarRacing
from msgs_bridge.errors import SimulatorError
import toy_simulator

class Failing(toy_simulator.Toy):
    def reset(self, seed):
        if getattr(self, 'frame', 0):
            raise SimulatorError('the engine is gone')
        return super().reset(seed)

class Gone(toy_simulator.Toy):
    def advance(self, command, frames=1):
        raise RuntimeError('the engine is gone')

    def close(self):
        print('let go of', flush=True)
        raise ConnectionError('nobody is there')

class Hanging(toy_simulator.Toy):
    step_of_it = 'close'

    def reset(self, seed):
        if seed == 1:
            self.step_of_it = 'advance'
        return super().reset(seed)

    def advance(self, command, frames=1):
        self.hang('advance')
        return super().advance(command, frames)

    def close(self):
        self.hang('close')

    def hang(self, where):
        if where == self.step_of_it:
            print('hanging', flush=True)
            while True:
                time.sleep(1)

class Unmade(CarRacing):
    def __init__(self, settings):
        raise SystemExit(0)
"""


@pytest.fixture(autouse=True)
def path(monkeypatch, tmp_path):
    """Let nodes find the toy, and what a test writes."""
    (tmp_path / 'failing.py').write_text(FAILING)
    monkeypatch.setenv('PYTHONPATH', f'{Path(__file__).parent}:{tmp_path}')


def call(graph, service, request=None, seconds=10):
    request = Trigger.Request() if request is None else request
    client = graph.probe.create_client(
        SetBool if isinstance(request, SetBool.Request) else Trigger,
        f'carracing_sim_node/{service}')
    graph.spin_until(client.service_is_ready, seconds, f'{service} is there')
    future = client.call_async(request)
    graph.spin_until(future.done, seconds, f'{service} answers')
    return future.result()


def steps_of(graph):
    return [read_step(read_named_values(message)) for message in graph.messages['step']]


def twist(stamp, forward=0.0, left=0.0):
    message = TwistStamped()
    set_stamp(message.header.stamp, stamp)
    message.twist.linear.x, message.twist.angular.z = forward, left
    return message


def ended(child, seconds=20):
    """Wait for the end of a node; return its code and its errors."""
    code = child.process.wait(seconds)
    child._reader.join(2)
    return code, [line for line in child.words if line.startswith('error: ')]


def test_a_toy_that_says_the_core_alone_is_driven_like_any_other(graph):
    graph.listen(topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.EPISODE)
    graph.node(*POLICY, model='random', wait_for_subscribers=2)
    values = {'simulator': TOY, 'action_repeat': 4, 'seed': 3, 'seed_each_episode': True}
    child = graph.node(*SIM, **values, episodes=3, wait_for_subscribers=1)
    graph.spin_until(lambda: len(graph.messages['episode']) == 6, 30, 'three episodes')
    graph.spin(0.3)
    assert ended(child) == (0, [])
    joined, joiner = graph.join()
    drive = open_drive(values)
    frame = drive.begin()
    for transition in joined:
        if frame.step.ended:
            frame = drive.begin()
        assert np.array_equal(transition.frame, frame.pixels)
        frame = drive.advance(transition.command, transition.stamp)
        assert np.array_equal(transition.next_frame, frame.pixels)
        assert transition.step == read_step(frame.step.values())
    assert frame.step.ended and frame.step.episode == 2
    assert joiner.counts['joined'] == len(joined)
    begins, ends = ([read_named_values(message) for message in graph.messages['episode'][n::2]]
                    for n in (0, 1))
    for number, (first, last) in enumerate(zip(begins, ends)):
        assert first['episode'] == last['episode'] == number and first['seed'] == 3 + number
        assert first['frame_seconds'] == 0.05 and first['contract_version'] == 2
        assert (first['terminated'], first['truncated'], first['decisions']) == (0, 0, 0)
        assert last['terminated'] or last['truncated']


def test_who_resets_the_last_episode_is_answered_before_the_node_ends(graph):
    graph.listen(topics.IMAGE, topics.STEP, topics.EPISODE)
    twists = graph.publisher(topics.CMD_VEL)
    child = graph.node(*SIM, simulator=TOY, episodes=2, start_paused=True, answer_timeout=60.0)
    graph.spin_until(lambda: graph.messages['step'], 20, 'the first frame')
    answer = call(graph, 'step')
    assert (answer.success, answer.message) == (True, '1 step to go as soon as a twist answers')
    twists.publish(twist(to_nanoseconds(graph.messages['step'][0].header.stamp)))
    graph.spin_until(lambda: len(graph.messages['step']) == 2, 5, 'one step')
    assert call(graph, 'reset').message == 'episode 1'
    answer = call(graph, 'reset')
    assert (answer.success, answer.message) == (True, 'all episodes are driven')
    assert ended(child) == (0, [])
    graph.spin(0.2)
    told = [read_named_values(message) for message in graph.messages['episode']]
    assert [(one['episode'], one['decisions'], one['truncated']) for one in told] == [
        (0, 0, 0), (0, 1, 1), (1, 0, 0), (1, 0, 1)]


def test_a_late_plain_twist_does_not_put_the_car_a_frame_behind(graph):
    graph.listen(topics.STEP)
    twists = graph.publisher(topics.CMD_VEL, 'geometry_msgs/msg/Twist')
    images = []

    def answer(image):
        images.append(to_nanoseconds(image.header.stamp))
        if len(images) == 4:
            # late, so that the image is sent again and answered twice
            time.sleep(0.45)
        message = Twist()
        message.linear.x = images[-1] // 50_000_000 % 997 / 1000
        twists.publish(message)

    graph.probe.create_subscription(Image, 'image_raw', answer, 100)
    graph.node(*SIM, simulator=TOY, cmd_vel_stamped=False, answer_timeout=0.3,
               wait_for_subscribers=0)
    graph.spin_until(lambda: len(graph.messages['step']) > 130, 40, 'driving')
    stamps = [to_nanoseconds(message.header.stamp) for message in graph.messages['step']]
    steps = steps_of(graph)
    assert len(images) > len(set(images)), 'nothing was sent again'
    for (stamp, _), (_, step) in itertools.pairwise(zip(stamps, steps)):
        if step.decision:
            assert step.info['linear'] == stamp // 50_000_000 % 997 / 1000
    assert steps[-1].episode >= 2


def test_two_simulators_by_simulation_time_share_one_clock(graph):
    """Both publish /clock and wait for none: use_sim_time stops no timer of theirs."""
    graph.listen(topics.CLOCK)
    nodes, other = graph.probe, f'{graph.namespace}_other'
    seen = {}
    for space, stepping, kind in ((graph.namespace, 'lockstep', TwistStamped),
                                  (other, 'real_time', Twist)):
        # the listener keeps what it was called with
        images, steps = seen[space] = [], []
        out = nodes.create_publisher(kind, f'/{space}/cmd_vel', 100)

        def drive(image, out=out, kind=kind, images=images):
            images.append(image)
            message = kind()
            if kind is TwistStamped:
                message.header.stamp = image.header.stamp
            (message.twist if kind is TwistStamped else message).linear.x = 0.5
            out.publish(message)

        nodes.create_subscription(Image, f'/{space}/image_raw', drive, 100)
        nodes.create_subscription(JointState, f'/{space}/step', steps.append, 100)
        graph.start(space, [*node_command('carracing_sim_node', {
            'simulator': TOY, 'stepping': stepping, 'cmd_vel_stamped': kind is TwistStamped,
        }, space), '-p', 'use_sim_time:=true'])
    graph.spin_until(lambda: all(len(images) > 60 for images, _ in seen.values()), 30, 'both')
    graph.spin(1.5)
    graph.messages['/clock'].clear()
    graph.spin(1.0)
    times = [to_nanoseconds(message.clock) for message in graph.messages['/clock']]
    assert len(times) > 10 and times == sorted(times)
    for _, steps in seen.values():
        moved = [read_named_values(message)['linear'] for message in steps]
        assert moved.count(0.5) > len(moved) / 2


def test_a_clock_whose_type_is_no_text_does_not_end_a_simulator(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    child = graph.node(*SIM, simulator=TOY, stepping='real_time')
    # it would leave the clock to one that was there before
    graph.spin_until(lambda: graph.health(SIM[1]).get('publishes_clock') == 'True', 30, 'its own')
    graph.start('forger', [
        sys.executable, str(Path(__file__).parent / 'forger.py'), topics.CLOCK.name, 'no_text'])
    graph.spin_until(lambda: graph.children['forger'].said('announced'), 20, 'the forged clock')
    graph.spin(2.5)
    count = len(graph.messages['step'])
    graph.spin_until(lambda: len(graph.messages['step']) > count + 5, 10, 'driving on')
    assert child.process.poll() is None


@pytest.mark.parametrize('act', ['drive', 'reset'])
def test_a_simulator_that_cannot_go_on_says_so_in_one_line(graph, act):
    graph.listen(topics.IMAGE, topics.STEP)
    twists = graph.publisher(topics.CMD_VEL)
    child = graph.node(*SIM, simulator='failing:Failing',
                       action_repeat=40 if act == 'drive' else 4)
    graph.spin_until(lambda: graph.messages['step'], 20, 'the first frame')
    stamp = to_nanoseconds(graph.messages['step'][0].header.stamp)
    if act == 'drive':
        # the frame ends the episode, and there is no next one
        twists.publish(twist(stamp))
    else:
        call(graph, 'pause', SetBool.Request(data=True))
        twists.publish(twist(stamp, left=0.1))
        call(graph, 'step')
        answer = call(graph, 'reset')
        assert not answer.success and answer.message == 'the engine is gone'
    assert ended(child) == (2, ['error: the engine is gone'])


def test_what_failed_first_is_the_line(graph):
    """An engine that is gone cannot be let go of, either."""
    child = graph.node(*SIM, simulator='failing:Gone', stepping='real_time')
    code, errors = ended(child, 60)
    assert code == 2 and len(errors) == 1 and child.said('let go of')
    assert 'failed in advance: RuntimeError: the engine is gone (failing.py' in errors[0]


def test_a_simulator_that_does_not_come_back_ends_with_the_node_all_the_same(graph):
    driving, closing = (
        graph.node(*SIM, simulator='failing:Hanging', stepping='real_time', seed=seed)
        for seed in (1, 2))
    graph.spin_until(lambda: driving.said('hanging'), 60, 'one hangs')
    graph.spin_until(lambda: closing.said('failing:Hanging, real_time'), 60, 'the other is made')
    graph.spin(0.5)
    for child in (driving, closing):
        child.signal(signal.SIGTERM)
    for child in (driving, closing):
        code, errors = ended(child, 60)
        assert child.said('hanging') and code == 2
        assert errors == ["error: simulator 'failing:Hanging' has not come back for 10 s: ended "
                          'without it']


def test_a_node_that_cannot_join_lets_go_of_its_simulator(graph):
    child = graph.node(*SIM, simulator='failing:Gone', **{
        f'qos_overrides./{graph.namespace}/image_raw.publisher.depth': 'many'})
    code, errors = ended(child, 60)
    assert code == 2 and len(errors) == 1 and 'qos_overrides of image_raw' in errors[0]
    assert child.said('let go of')


@pytest.mark.parametrize(('simulator', 'told'), [
    ('slow', 'accepted: carracing, carracing_colours, '), ('failing:Nothing', "has no 'Nothing'"),
    ('failing:Unmade', 'failed in __init__: SystemExit: 0 (failing.py'),
    ('toy_simulator:Toy', "unknown setting 'zoom'")])
def test_a_simulator_that_is_not_there_ends_the_node_with_one_line(graph, simulator, told):
    code, errors = ended(graph.node(*SIM, simulator=simulator, zoom=False))
    assert code == 2 and len(errors) == 1 and told in errors[0]


def test_passing_over_a_million_tracks_can_be_stopped(graph):
    child = graph.node(*SIM, first_episode=10**6)
    graph.spin_until(lambda: child.said('passing over'), 20, 'passing over tracks')
    graph.spin(0.2)
    child.signal(signal.SIGINT)
    assert child.process.wait(5) in (0, 130)


def test_a_flood_of_twists_is_counted_and_the_drive_goes_on(graph):
    graph.listen(topics.STEP, topics.DIAGNOSTICS)
    twists = graph.publisher(topics.CMD_VEL)
    graph.node(*POLICY, model='random')
    graph.node(*SIM, simulator=TOY, action_repeat=4)
    graph.spin_until(lambda: len(graph.messages['step']) > 20, 30, 'driving')
    odd = twist(0, forward=float('nan'))
    for number in range(6_000):
        odd.header.stamp.sec = (-5, 2**31 - 1, number)[number % 3]
        odd.header.stamp.nanosec = (0, 2**32 - 1, 5)[number % 3]
        odd.twist.linear.x = (float('inf'), 0.5, 9.0)[number // 3 % 3]
        twists.publish(odd)
    graph.spin(0.2)
    count = len(graph.messages['step'])
    graph.spin_until(lambda: len(graph.messages['step']) > count + 100, 40, 'driving on')

    def counted():
        health = graph.health(SIM[1])
        return int(health.get('rejected_cmd_vel', 0)) + int(health.get('lost_cmd_vel', 0))

    # of those that the middleware let through, every one is refused
    graph.spin_until(lambda: counted() > 500, 10, 'the flood is counted')
    steps = steps_of(graph)
    assert all(abs(step.info['linear']) <= 1 for step in steps)


LEARNING = {
    'simulator': TOY, 'frame_height': 32, 'frame_width': 48, 'frame_seconds': 0.05,
    'action_repeat': 4, 'convolutions': '8@8/4 16@4/2', 'hidden': 64, 'learning_starts': 64,
    'replay_capacity': 5000, 'samples_per_transition': 8.0, 'learning_rate': 0.001,
    'loss': 'huber', 'reward_scale': 0.25, 'gamma': 0.9, 'target_update': 'updates',
    'target_every': 100, 'epsilon_schedule': 'decisions', 'epsilon_decisions': 400,
    'epsilon_end': 0.1, 'weights_every': 20, 'validation_tracks': 10,
    'validation_every_episodes': 50, 'run_episodes': 0, 'run_decisions': 700,
}


def test_a_toy_is_learned_from_over_topics(tmp_path):
    preset, run = tmp_path / 'toy.yaml', tmp_path / 'run'
    preset.write_text(yaml.safe_dump(LEARNING))
    result = carracing('train', '--preset', str(preset), '--run', str(run), '--namespace', 'toy',
                       timeout=240)
    assert result.returncode == 0, result.stdout + result.stderr
    learned = drive_laps(PolicySource('model', str(run / 'final')), range(20), simulator=TOY)
    # by chance nothing is gained; who goes straight to the bar gains 8 to 32, 18 in the mean
    assert np.mean([lap.episode_return for lap in learned]) > 8
    # an episode says nothing of tiles or laps, and its row holds nothing
    assert ',,,,' in (run / 'episodes.csv').read_text().splitlines()[-1]
    assert (run / 'validation.csv').read_text().count('\n') > 1
