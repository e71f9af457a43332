# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The state that is watched: bounded whatever comes, and what is wrong named by its cause."""
import io
import json
import math

from bag_cases import bundle, image, serialized, stamp_of, TYPES, twist
from carracing_dqn.watch import causes, painting
from carracing_dqn.watch.car import MAX_SMALL_BYTES
from carracing_dqn.watch.graph_parts import End, Misfit, RATE_SECONDS, Topic, TopicEnds
from carracing_dqn.watch.series import KEPT_SECONDS, MAX_NAMES, QUIET_SECONDS, SeriesTable
from carracing_dqn.watch.state import (
    cars_first, MAX_CARS, MAX_NODES, MAX_TOPICS, WatchState,
)
from msgs_bridge.bars import share_between
from msgs_bridge.step import Step
from msgs_bridge.topics import CMD_VEL, DIAGNOSTICS, IMAGE, Q_VALUES, STEP, TOPICS, WEIGHTS
from msgs_bridge.twists import Command
import numpy as np
import pytest
from rich.console import Console

SIMULATOR, POLICY, TRAINER, RECORDER = (
    '/carracing_sim_node', '/dqn_policy_node', '/trainer_node', '/bag_recorder_node')
FRAME = 40_000_000
"""ns from one image to the next, at which the shipped model decides."""


def end(node, topic, **changes):
    return End(node, topic.type_name, 'reliable')._replace(**changes)


def ends(topic, publisher, *subscriptions):
    return TopicEnds(topic.type_name, [end(publisher, topic)],
                     [end(node, topic) for node in subscriptions])


GRAPH = {
    '/image_raw': ends(IMAGE, SIMULATOR, POLICY), '/step': ends(STEP, SIMULATOR, TRAINER),
    '/cmd_vel': ends(CMD_VEL, POLICY, SIMULATOR), '/q_values': ends(Q_VALUES, POLICY),
    '/diagnostics': ends(DIAGNOSTICS, SIMULATOR)}
NODES = (SIMULATOR, POLICY)


def health(node, summary='driving', level=0, **values):
    status, pair = (TYPES.types[f'diagnostic_msgs/msg/{name}']
                    for name in ('DiagnosticStatus', 'KeyValue'))
    header = TYPES.types['std_msgs/msg/Header'](stamp_of(0), '')
    return serialized(DIAGNOSTICS.type_name, header, [status(
        level, node, summary, 'x', [pair(key, str(value)) for key, value in values.items()])])


def simulator(**values):
    return health(SIMULATOR, simulator='carracing', decisions_per_second=50, paused=False,
                  **values)


def policy(**values):
    return health(POLICY, **{'weights_version': 7, 'sequences': 1, 'decision_seconds': 0.04,
                             'enabled': True, 'epsilon': 0, **values})


def frame(red=(122, 55, 55)):
    pixels = np.full((96, 96, 3), 100, np.uint8)
    pixels[68:76, 45:51] = red
    return pixels


def step_bundle(number, applied, angular, **info):
    step = Step(1.0, False, False, 0, number, float(number), 5, applied,
                {'linear': 0.2, 'angular': angular, 'speed': 30.0, **info})
    return bundle(number * FRAME, step.values())


def drive(state, *, frames=30, period=FRAME, red=(122, 55, 55), told=0.3, applied=0.3,
          begin=0, extra=()):
    """Let a car drive; `applied` is what the simulator makes of the angular it is `told`."""
    for number in range(begin, begin + frames):
        now = number / 5
        state.see_graph(NODES, GRAPH, now)
        for data in (simulator(), policy(), *extra):
            state.take('/diagnostics', DIAGNOSTICS.type_name, data, now)
        for half in (2 * number, 2 * number + 1):
            stamp = half * period
            state.take('/image_raw', IMAGE.type_name, image(stamp, frame(red)), now, half + 1)
            state.take('/cmd_vel', CMD_VEL.type_name, twist(stamp, Command(0.2, told)), now)
            values = {'left': 1.5, 'gas': 2.5, 'chosen': 1, 'explored': 0, 'weights_version': 7}
            state.take('/q_values', Q_VALUES.type_name, bundle(stamp, values), now, half + 1)
            values = Step(1.0, False, False, 0, half, float(half), 5,
                          stamp - period if half else None,
                          {'linear': 0.2, 'angular': applied, 'speed': 30.0}).values()
            state.take('/step', STEP.type_name, bundle(stamp, values), now, half + 1)
        state.look(now)
    return now


def kinds(state, now):
    return [cause['kind'] for cause in state.snapshot(now)['causes']]


def test_of_an_action_along_two_axes_both_nodes_are_marked():
    state = WatchState('test')
    now = drive(state)
    stamp = round(state.snapshot(now)['picture']['stamp'] * 1e9)
    for second, marked in ((2, (0, 2)), (-1, (0,))):
        values = {'linear -1': 1.0, 'linear 1': 2.0, 'angular -1': 3.0, 'chosen': 0,
                  'chosen_second': second, 'explored': 0, 'weights_version': 7}
        state.take('/q_values', Q_VALUES.type_name, bundle(stamp, values), now, 99)
        state.look(now)
        shown = state.snapshot(now)
        assert shown['drive']['chosen'] == marked
        assert painting.drive(shown).plain.count('▶') == len(marked)


def test_a_car_that_drives_well_is_shown_whole_and_nothing_is_wrong():
    state = WatchState('test')
    now = drive(state)
    shown = state.snapshot(now)
    json.dumps(shown, allow_nan=False)
    assert shown['causes'] == [] and shown['rejected'] == 0
    assert shown['drive']['actions'] == [['left', 1.5], ['gas', 2.5]]
    assert shown['drive']['chosen'] == (1,) and shown['drive']['speed'] == 30
    assert (shown['drive']['linear'], shown['drive']['angular']) == (0.2, 0.3)
    assert shown['picture']['width'] == 96 and shown['switches']['enabled']
    assert (state.pixels()[70, 47] == (122, 55, 55)).all()
    assert [round(topic['rate']) for topic in shown['topics'] if topic['name'] == '/step'] == [10]
    assert {'episode_return', 'speed'} <= shown['plots'].keys()
    assert {'q.gas', 'speed', 'dqn_policy_node.epsilon'} <= set(shown['series'])
    assert state.snapshot(now, plots=['q.gas'])['plots'].keys() == {'q.gas'}


def test_the_picture_goes_with_the_step_and_the_values_of_its_stamp():
    state = WatchState('test')
    drive(state, frames=5)
    # the next step comes before its image does
    state.take('/step', STEP.type_name, step_bundle(10, None, 0.0), 1.0)
    state.look(1.0)
    assert state.snapshot(1.0)['drive']['decision'] == 9
    state.take('/image_raw', IMAGE.type_name, image(10 * FRAME, frame()), 1.2)
    state.look(1.2)
    assert state.snapshot(1.2)['drive']['decision'] == 10


@pytest.mark.parametrize(('changes', 'kind'), [
    ({'red': (55, 55, 122)}, 'swapped colours'),
    ({'period': 2 * FRAME}, 'low rate'),
    ({'applied': -0.3}, 'mirrored steering'),
])
def test_what_pictures_and_twists_tell(changes, kind):
    state = WatchState('test')
    assert kinds(state, drive(state, **changes)) == [kind]


@pytest.mark.parametrize(('parameters', 'kind'), [
    ({'angular_scale': -1.0}, 'mirrored steering'),
    ({'camera_mirror': True}, 'mirrored steering'),
    ({'camera_encoding': 'bgr8'}, 'swapped colours'),
])
def test_what_parameters_tell(parameters, kind):
    state = WatchState('test')
    now = drive(state)
    state.take_parameters(POLICY, parameters)
    assert kinds(state, now) == [kind]
    assert state.snapshot(now)['causes'][0]['where'] == POLICY


def test_a_camera_that_lies_and_a_policy_that_knows_it_are_well():
    state = WatchState('test')
    now = drive(state, red=(55, 55, 122))
    state.take_parameters(POLICY, {'camera_encoding': 'bgr8'})
    assert kinds(state, now) == []


def test_ends_that_do_not_match_and_names_that_do_not_meet():
    state = WatchState('test')
    plain = End(POLICY, 'geometry_msgs/msg/Twist', 'reliable')
    state.see_graph(NODES, {
        '/cmd_vel': TopicEnds(plain.type_name, [plain], [end(SIMULATOR, CMD_VEL)], [
            Misfit('type', POLICY, SIMULATOR, 'types differ')]),
        '/image_raw': TopicEnds(IMAGE.type_name, [end(SIMULATOR, IMAGE, reliable=False)],
                                [end(POLICY, IMAGE)], [
                                    Misfit('QoS', SIMULATOR, POLICY, 'best effort, reliable')]),
    }, 1.0)
    assert kinds(state, 1.0) == ['plain twist', 'best effort']
    state.see_graph(NODES, {
        '/image_raw': ends(IMAGE, SIMULATOR, RECORDER),
        '/camera/image': TopicEnds(IMAGE.type_name, [], [end(POLICY, IMAGE)])}, 2.0)
    (cause,) = state.snapshot(2.0)['causes']
    assert cause['kind'] == 'wrong remap' and '/camera/image' in cause['text']
    assert cause['mend'] == f'-r image:=/image_raw at {POLICY}'
    # a policy of ours calls it image_raw, whatever it has been remapped to
    state.see_graph(NODES, GRAPH, 2.0)
    state.take('/diagnostics', DIAGNOSTICS.type_name, policy(), 2.0)
    state.see_graph(NODES, {
        '/image_raw': ends(IMAGE, SIMULATOR, RECORDER),
        '/camera/image': TopicEnds(IMAGE.type_name, [], [end(POLICY, IMAGE)])}, 2.0)
    (cause,) = state.snapshot(2.0)['causes']
    assert cause['mend'] == f'-r image_raw:=/image_raw at {POLICY}'
    # of topics of one type those of one name are meant for each other
    state.see_graph(NODES, {
        '/step': ends(STEP, SIMULATOR), '/q_values': ends(Q_VALUES, POLICY),
        '/nowhere/step': TopicEnds(STEP.type_name, [], [end(TRAINER, STEP)])}, 3.0)
    (cause,) = state.snapshot(3.0)['causes']
    assert cause['mend'] == f'-r step:=/step at {TRAINER}'


def test_a_watch_that_was_held_up_blames_nobody_for_it():
    state = WatchState('test')
    now = drive(state)
    state.look(now + 20)
    assert kinds(state, now + 20) == []
    for second in range(21, 30):
        state.see_graph(NODES, GRAPH, now + second)
        state.look(now + second)
    assert kinds(state, now + 29) == ['node silent'] * 2


def test_a_trainer_is_compared_with_those_who_hear_it():
    state = WatchState('test')

    def hear(trainer, begin, graph=GRAPH):
        for number in range(begin, begin + 60):
            now = number / 5
            state.see_graph((*NODES, trainer), graph, now)
            for data in (simulator(), policy(), health(
                    trainer, 'learning', progress=0.1, weights_version=90, decisions=number)):
                state.take('/diagnostics', DIAGNOSTICS.type_name, data, now)
        return kinds(state, now)

    state.see_graph(NODES, GRAPH, 0.0)
    assert hear('/other/trainer_node', 0) == []
    heard = {**GRAPH, '/other/weights': ends(WEIGHTS, '/other/trainer_node', POLICY)}
    assert hear('/other/trainer_node', 60, heard) == ['stale weights']


def test_nothing_is_said_to_be_well_before_it_has_been_seen():
    state = WatchState('test')
    assert state.snapshot(0.0)['looking']
    now = drive(state, frames=5)
    assert state.snapshot(now)['looking']
    now = drive(state, frames=100, begin=5)
    # their parameters may be what is wrong
    assert state.snapshot(now)['looking']
    for node in NODES:
        state.take_parameters(node, {})
    assert not state.snapshot(now)['looking']


def test_a_judge_that_fails_is_told_of_and_the_others_go_on(monkeypatch):
    def _odd(state, now):
        yield causes.Cause('before', '/it', 'is dropped')
        raise ValueError('odd\x1b[2J' * 1000)

    state = WatchState('test')
    drive(state, extra=(health(RECORDER, 'the disk is full', level=2),))
    assert kinds(state, 0.0) == ['error']
    monkeypatch.setattr(causes, 'JUDGES', (_odd, *causes.JUDGES))
    other, failed = state.snapshot(0.0)['causes']
    assert (other['kind'], failed['kind'], failed['where']) == ('error', 'watch', 'odd')
    assert 'ValueError: odd?[2J' in failed['text'] and len(failed['text']) <= causes.MAX_REASON


@pytest.mark.parametrize('rows', [3, 6, 9])
def test_of_what_is_wrong_no_more_is_shown_than_there_is_room_for(rows):
    found = [{'kind': 'error', 'where': f'/node_{number}', 'text': 'a word ' * 20, 'mend': 'it'}
             for number in range(5)]
    lines = painting.causes({'causes': found, 'looking': False}, 76, rows).plain.split('\n')
    whole = sum(line.startswith('  mend: it') for line in lines)
    assert len(lines) <= rows and max(map(len, lines)) <= 76
    assert lines[0].startswith('error /node_0: a word')
    assert lines[-1] == f'and {5 - max(whole, 1)} more, below the nodes'
    assert whole or lines[-2] == '…'


def test_nodes_that_fall_silent_go_or_have_no_room():
    state = WatchState('test')
    hear = (health(RECORDER, 'recording'), health(TRAINER, 'learning', progress=1))
    now = drive(state, extra=hear)
    state.see_graph((*NODES, RECORDER, TRAINER), GRAPH, now)
    assert kinds(state, now) == []
    now = drive(state, frames=60, begin=30)
    state.see_graph((*NODES, TRAINER), GRAPH, now)
    found = {cause['where']: cause for cause in state.snapshot(now)['causes']}
    assert {where: cause['kind'] for where, cause in found.items()} == {
        RECORDER: 'node gone', TRAINER: 'node silent'}
    assert 'recording' in found[RECORDER]['text']
    text = 'recording ended: No space left on device'
    now = drive(state, begin=90, extra=[health(RECORDER, text, 2)])
    now = drive(state, begin=120)
    assert kinds(state, now)[0] == 'full disk'


def test_weights_that_fall_behind_and_a_trainer_that_takes_nothing():
    state = WatchState('test')
    trainer = {'progress': 0.1, 'weights_version': 9, 'decisions': 5}
    now = drive(state, extra=[health(TRAINER, 'learning', **trainer)], frames=20)
    state.see_graph((*NODES, TRAINER), GRAPH, now)
    assert kinds(state, now) == []
    trainer['weights_version'] = 30
    now = drive(state, extra=[health(TRAINER, 'learning', **trainer)], frames=50, begin=20)
    state.see_graph((*NODES, TRAINER), GRAPH, now)
    assert kinds(state, now) == ['stale weights', 'silent trainer']


def test_listeners_for_whom_a_simulator_once_waited():
    state = WatchState('test')
    now = drive(state)
    state.take_parameters(SIMULATOR, {'wait_for_subscribers': 2})
    assert kinds(state, now) == ['listener gone']


def test_a_pause_is_nothing_wrong():
    state = WatchState('test')
    now = drive(state)
    state.take('/diagnostics', DIAGNOSTICS.type_name, health(
        SIMULATOR, simulator='carracing', decisions_per_second=0, paused=True), now)
    state.take('/diagnostics', DIAGNOSTICS.type_name, health(
        POLICY, 'no image for 2 s', 1, weights_version=7, sequences=1), now)
    assert kinds(state, now) == [] and state.snapshot(now)['switches']['paused']


def test_nothing_that_comes_ends_it_and_everything_is_bounded():
    state = WatchState('test')
    now = drive(state, frames=5)
    random = np.random.default_rng(0)
    for topic in TOPICS:
        name = topic.name if topic.name.startswith('/') else f'/{topic.name}'
        for size in (0, 3, 40, 500):
            state.take(name, topic.type_name, random.bytes(size), now)
            state.take(name, 'no/msg/Type', random.bytes(size), now)
    good = image(1, frame())
    state.take('/image_raw', IMAGE.type_name, good[:-5], now)
    state.take('/step', STEP.type_name, bundle(2, {'reward': float('nan')}), now)
    state.take('/step', STEP.type_name, b'\0' * (MAX_SMALL_BYTES + 1), now)
    state.take('/q_values', Q_VALUES.type_name, bundle(
        3, {'a': float('inf'), 'chosen': 1e300, 'explored': 0, 'weights_version': 0}), now)
    state.take('/diagnostics', DIAGNOSTICS.type_name, health('\x1b[31m' * 1000), now)
    for number in range(3 * MAX_NODES):
        state.take('/diagnostics', DIAGNOSTICS.type_name, health(f'/n{number}', 'x' * 999), now)
    state.see_graph([f'/m{number}' for number in range(999)], {
        f'/c{number}/image_raw': ends(IMAGE, SIMULATOR) for number in range(999)}, now)
    state.look(now)
    shown = state.snapshot(now)
    text = json.dumps(shown, allow_nan=False)
    assert shown['rejected'] > 5
    assert len(state.nodes) <= MAX_NODES and len(state.topics) <= MAX_TOPICS
    assert len(state.cars) <= MAX_CARS and '\\u001b' not in text


def test_what_has_gone_or_is_made_up_keeps_no_room_from_what_is_there():
    state = WatchState('test')
    for number in range(2 * MAX_CARS):
        # cars come and go
        state.see_graph([], {f'/car_{number}/step': ends(STEP, SIMULATOR)}, float(number))
    assert f'/car_{number}' in state.cars and len(state.cars) <= MAX_CARS
    state.see_graph([], GRAPH, now := 50.0)
    for number in range(2 * MAX_NODES):
        state.take('/diagnostics', DIAGNOSTICS.type_name, health(f'camera: part {number}'), now)
    state.take('/diagnostics', DIAGNOSTICS.type_name, health(''), now)
    state.see_graph(NODES, GRAPH, now)
    assert set(NODES) <= set(state.nodes) and len(state.nodes) <= MAX_NODES
    assert '' not in state.nodes
    state.take_parameters(POLICY, {'wait_for_subscribers': 2})
    state.see_graph((SIMULATOR,), GRAPH, now + 1000)
    assert POLICY not in state.nodes and POLICY not in state.parameters


def test_topics_of_a_car_come_before_those_of_everybody_else():
    others = {f'/a/{number}': ('sensor_msgs/msg/PointCloud2',) for number in range(999)}
    shown = cars_first({
        **others, '/front/picture': (IMAGE.type_name,), '/robot/step': (STEP.type_name,),
        '/image_raw': (IMAGE.type_name,), '/diagnostics': (DIAGNOSTICS.type_name,)})
    assert shown[:4] == ['/diagnostics', '/image_raw', '/robot/step', '/front/picture']
    assert len(shown) == 1003


def test_no_name_from_outside_is_more_than_a_name():
    state, now = WatchState('test'), 5.0
    evil = '\x1b]0;OWNED\x07'
    state.see_graph(NODES, {**GRAPH, f'/{evil}/image_raw': ends(IMAGE, SIMULATOR),
                            '/' + 'x' * 300: ends(STEP, SIMULATOR)}, now)
    step = Step(1.0, False, False, 0, 99, 99.0, 5, None, {f'{evil}speed': 1.0})
    state.take('/step', STEP.type_name, bundle(10**12, step.values()), now + 1)
    state.look(now + 1)
    name = next(one for one in state.snapshot(now + 1)['series'] if 'OWNED' in one)
    # it is asked for as it is told
    shown = state.snapshot(now + 1, plots=[name])
    assert list(shown['plots']) == [name]
    assert set(state.topics) == set(GRAPH)
    painted = [painting.topics(shown), painting.plots(shown, 40), painting.drive(shown)]
    console = Console(file=io.StringIO(), width=100, force_terminal=False)
    console.print(*painted)
    for text in (json.dumps(shown, ensure_ascii=False), console.file.getvalue()):
        assert '\x1b' not in text and '\x07' not in text


@pytest.mark.parametrize('values', [
    {'a': None}, {}, {'a': None, 'b': 1.0}, {'a': 1.7e308, 'b': -1.7e308}, {'a': 1.0, 'b': 1.0}])
def test_any_values_of_actions_can_be_painted(values):
    shown = {'drive': {'actions': list(values.items()), 'chosen': (0,), 'explored': False}}
    bars = [line.count('█') for line in painting.drive(shown).plain.split('\n')[-1 - len(values):]]
    assert max(bars) <= painting.BAR_WIDTH
    if values.get('b') == -1.7e308:
        assert bars[:2] == [painting.BAR_WIDTH, 1]


@pytest.mark.parametrize(('value', 'low', 'high', 'share'), [
    (1, 0, 4, 0.25), (0, -1.7e308, 1.7e308, 0.5), (1.7e308, -1.7e308, 1.7e308, 1.0),
    (1e-320, 0, 2e-320, 0.5), (2, 2, 2, 0.0), (9, 0, 1, 1.0), (-9, 0, 1, 0.0),
    (math.nan, 0, 1, 0.0), (1, 0, math.inf, 0.0), (0, -math.inf, 1, 0.0)])
def test_a_bar_has_a_length_whatever_the_numbers(value, low, high, share):
    assert share_between(value, low, high) == share


def test_series_are_bounded_in_names_and_time_and_go_back_with_a_bag():
    table = SeriesTable()
    for number in range(3 * int(KEPT_SECONDS)):
        table.add(float(number), {f'{number}': 1.0, 'nan': float('nan'), 'x': float(number)})
    assert len(table) == MAX_NAMES and table.points('nan', 0.0) == []
    points = table.points('x', 900.0)
    assert 0 < len(points) <= KEPT_SECONDS and points[-1] == (1.0, 899.0)
    table.add(5.0, {'x': 1.0})
    assert table.points('x', 5.0) == [(0.0, 1.0)]


def test_made_up_names_of_numbers_keep_no_room_from_those_that_come():
    table = SeriesTable()
    table.add(0.0, {f'{number}': 1.0 for number in range(2 * MAX_NAMES)})
    table.add(1.0, {'speed': 1.0, '0': 1.0})
    assert table.points('speed', 1.0) == []
    for at in (QUIET_SECONDS + 0.5, QUIET_SECONDS + 1.0):
        table.add(at, {'speed': 1.0, '0': 1.0})
    assert len(table.points('speed', at)) == 2 and len(table.points('0', at)) == 4
    assert len(table) == MAX_NAMES


def test_rates_come_from_the_publishers_numbers_and_fall_when_it_stops():
    topic = Topic('/x', ends(STEP, SIMULATOR))
    assert topic.rate(0.0) is None
    for look in range(40):
        topic.came(look / 10, 10, 100 * look + 1)
    assert topic.rate(3.9) == pytest.approx(1000, rel=0.01)
    assert topic.rate(5.5) < 700 and topic.rate(3.9 + 2 * RATE_SECONDS) == 0
