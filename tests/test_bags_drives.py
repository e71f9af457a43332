# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Drives out of bags: joined, driven again, summed up, exported."""
import argparse
from collections import Counter
import csv
import dataclasses
import json
from pathlib import Path

import av
from bag_cases import bundle, DriveRecorder, image, record_drive, scripted, small_bag, twist
from bags.command import add_arguments, main
from bags.decode import decode_bundle, decode_image
from bags.episodes import find_episodes
from bags.errors import BagError
from bags.export import export_csv, export_video
from bags.frames import recorded_frames, RecordedFrame
from bags.image_arrays import load_images
from bags.info import bag_info, show_info
from bags.painter import BLUE, FramePainter, GREEN
from bags.reader import BagReader
from bags.schemas import Schema
from bags.transitions import bag_transitions
from bags.verify import verify_bag
from bags.writer import BagWriter
from carracing_dqn.simulation import open_drive
from carracing_sim_node import make_env
from carracing_sim_node.controls import controls
from msgs_bridge.step import STEP_CORE
from msgs_bridge.errors import SimulatorError
from msgs_bridge.step import read_step
from msgs_bridge.topics import CMD_VEL, EPISODE, IMAGE, Q_VALUES, STEP
from msgs_bridge.twists import Command
import numpy as np
from PIL import Image
import pytest
from rich.console import Console
import toy_simulator


@pytest.fixture(scope='module')
def drive(tmp_path_factory):
    """Return a bag of two whole episodes of 40 decisions."""
    return record_drive(tmp_path_factory.mktemp('drive') / 'bag')


@pytest.fixture(scope='module')
def short(tmp_path_factory):
    """Return a bag of two whole episodes of 12 decisions."""
    return record_drive(tmp_path_factory.mktemp('short') / 'bag', decisions=12)


def verified(folder, **options):
    with BagReader(folder) as reader:
        return verify_bag(reader, **options)


def changed(source, folder, change, times=1):
    """
    Copy a bag, several times in turn if need be.

    `change` takes a topic, how many of its messages came before, and a message; it gives those
    that are written in its place.
    """
    numbers = Counter()
    with BagReader(source) as reader, BagWriter(
            folder, custom_data=reader.custom_data) as writer:
        topics = {name: writer.add_topic(name, topic.type_name, topic.qos)
                  for name, topic in reader.topics.items()}
        for turn in range(times):
            for one in reader.messages():
                for data in change(one.topic, numbers[one.topic], bytes(one.data)):
                    writer.write(topics[one.topic], one.log_time + turn * 10 ** 12,
                                 one.publish_time, data)
                numbers[one.topic] += 1
    return folder


def with_odd(source, folder, topic, odd, at=10):
    """Copy a bag, with what `odd` makes of a message behind it."""
    return changed(source, folder, lambda name, number, data: (
        [data, *odd(data)] if (name, number) == (topic, at) else [data]))


def with_values(source, folder, topic, **values):
    """Copy a bag with other values in the bundles of a topic."""
    def change(name, _, data):
        if name != topic:
            return [data]
        held = decode_bundle(data, name)
        return [bundle(held.stamp, {**held.values_with(), **values})]
    return changed(source, folder, change)


def stamped(seconds):
    """Return what gives a message another stamp, in whole seconds."""
    return lambda data: [data[:4] + seconds.to_bytes(4, 'little') + data[8:]]


def junk(_):
    return [b'\0\1\0\0']


def not_a_number(data):
    held = decode_bundle(data, 'x')
    return [bundle(held.stamp, {**held.values_with(), 'reward': float('nan')})]


def command(*words):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return main(parser.parse_args([str(word) for word in words]))


def test_a_bag_joins_into_the_transitions_that_happened(drive):
    counts = Counter()
    transitions = list(bag_transitions([drive, drive], counts=counts))
    assert len(transitions) == 160
    assert {name: count for name, count in counts.items() if count} == {'joined': 160}
    env = make_env(max_episode_steps=40)
    frame, _ = env.reset(seed=5)
    for number, transition in enumerate(transitions[:40]):
        assert np.array_equal(transition.frame, frame)
        assert transition.command == scripted(number)
        frame, reward, _, truncated, _ = env.step(controls(transition.command))
        assert np.array_equal(transition.next_frame, frame)
        assert transition.step.reward == reward
        assert transition.truncated == truncated
    assert truncated


@pytest.mark.parametrize('twist_type', [CMD_VEL.type_name, 'geometry_msgs/msg/Twist'])
def test_without_stamped_twists_the_action_is_what_step_says(tmp_path, drive, twist_type):
    with BagReader(drive) as reader, BagWriter(tmp_path / 'bag') as writer:
        names = ['/image_raw', '/step', '/cmd_vel']
        numbers = {name: writer.add_topic(name, reader.topics[name].type_name)
                   for name in names[:2]}
        plain = writer.add_topic('/cmd_vel', twist_type)
        for message in reader.messages(names):
            if message.topic in numbers:
                writer.write(numbers[message.topic], *message[1:3], bytes(message.data))
            elif twist_type != CMD_VEL.type_name:
                # the encapsulation and, behind the header, the twist itself
                data = bytes(message.data)
                writer.write(plain, *message[1:3], data[:4] + data[-48:])
    found = list(bag_transitions([tmp_path / 'bag']))
    expected = list(bag_transitions([drive]))
    assert [one.command for one in found] == [one.command for one in expected]
    assert [one.stamp for one in found] == [one.stamp for one in expected]


def test_a_damaged_message_drops_one_transition_and_no_other(tmp_path):
    recorder = DriveRecorder(tmp_path / 'bag')
    values = {**dict.fromkeys(STEP_CORE, 0), 'reward': 1.0}
    pixels = np.zeros((96, 96, 3), np.uint8)
    for number in range(6):
        stamp = (number + 1) * 10 ** 9
        recorder.put(STEP, bundle(stamp, {**values, 'decision': number, 'applied_sec': number}))
        recorder.put(IMAGE, image(stamp, pixels))
        if number == 3:
            recorder.put(CMD_VEL, twist(stamp, Command(0.0, float('nan'))))
        else:
            recorder.put(CMD_VEL, twist(stamp, Command(0.0, 0.1 * number)))
    recorder.writer.close()
    counts = Counter()
    found = list(bag_transitions([tmp_path / 'bag'], counts=counts))
    assert [one.step.decision for one in found] == [1, 2, 3, 5]
    assert counts['rejected'] == counts['lost_twist'] == 1


def test_topics_in_a_namespace_are_found_and_two_namespaces_need_a_choice(tmp_path):
    bag = record_drive(tmp_path / 'bag', namespace='/red', episodes=1, decisions=5)
    assert len(list(bag_transitions([bag]))) == 5
    assert verified(bag).resimulation.differing_frames == 0
    with pytest.raises(BagError, match='has no image_raw'):
        list(bag_transitions([bag], namespace='blue'))
    recorder = DriveRecorder(tmp_path / 'two', namespace='/red')
    recorder.writer.add_topic('/blue/image_raw', IMAGE.type_name)
    recorder.writer.close()
    with pytest.raises(BagError, match='more than once.*choose with --namespace'):
        list(bag_transitions([tmp_path / 'two']))
    assert list(bag_transitions([tmp_path / 'two'], namespace='red')) == []


def test_a_recording_of_what_happened_has_no_differing_frame(drive):
    found = verified(drive)
    assert found.good
    assert found.transitions == {'joined': 80}
    driven = found.resimulation
    assert (driven.episodes, driven.frames, driven.differing_frames) == (2, 82, 0)


def test_verify_finds_twists_that_are_not_what_was_applied(tmp_path):
    def told(number):
        # more than full gas is applied as full gas
        return lambda name, _, data: [
            data[:-48] + np.array([number, 0, 0, 0, 0, 0.0]).tobytes()
            if name == '/cmd_vel' else data]

    bag = record_drive(tmp_path / 'bag', decisions=6, drive_with=lambda _: Command(1.0, 0.0))
    assert verified(changed(bag, tmp_path / 'more', told(3.0))).good
    found = verified(changed(bag, tmp_path / 'others', told(-1.0)), resimulate=False)
    assert found.problems == ['12 twists are not what step says was applied, the first before '
                              'episode 0, decision 1']


@pytest.mark.parametrize(('topic', 'odd', 'count', 'told'), [
    ('/step', junk, 'rejected', ['1 messages cannot be used']),
    ('/step', not_a_number, 'rejected', ['1 messages cannot be used']),
    ('/image_raw', junk, 'rejected', ['1 messages cannot be used']),
    ('/cmd_vel', junk, 'rejected', ['1 messages cannot be used']),
    ('/step', stamped(2_000_000_000), 'odd_step', []),
    ('/image_raw', stamped(2_000_000_000), None, []),
    # the joiner believes two that follow each other
    ('/image_raw', lambda data: [*stamped(1_000_000)(data), *stamped(1_000_001)(data)],
     'lost_image', ['2 transitions lack an image']),
    ('/q_values', junk, None, []),
])
def test_one_odd_message_costs_no_other_frame(tmp_path, short, topic, odd, count, told):
    found = verified(with_odd(short, tmp_path / 'bag', topic, odd))
    assert found.problems == told
    lost = 2 * (count == 'lost_image')
    assert found.transitions == {
        'joined': 24 - lost, **({count: lost or 1} if count else {})}
    driven = found.resimulation
    assert (driven.frames, driven.missing_images, driven.differing_frames) == (26, 0, 0)
    counts = Counter()
    with BagReader(short) as reader:
        expected = list(recorded_frames(reader))
    with BagReader(tmp_path / 'bag') as reader:
        frames = list(recorded_frames(reader, counts=counts))
        episodes = bag_info(reader)['episodes']
    assert counts['rejected'] == (odd in (junk, not_a_number) and topic != '/cmd_vel')
    assert [(one.stamp, one.step, one.q_values) for one in frames] == [
        (one.stamp, one.step, one.q_values) for one in expected]
    assert all(np.array_equal(one.pixels, other.pixels) for one, other in zip(frames, expected))
    assert [episode['decisions'] for episode in episodes] == [12, 12]


@pytest.mark.parametrize('lost', [lambda data: [], not_a_number, stamped(10 ** 9)])
def test_a_step_that_is_missing_calls_no_other_frame_different(tmp_path, short, lost):
    bag = changed(short, tmp_path / 'bag', lambda name, number, data: (
        lost(data) if (name, number) == ('/step', 5) else [data]))
    found = verified(bag)
    assert not found.good and 'transitions lack a step' in found.problems[0]
    assert found.resimulation.differing_frames == 0
    assert found.resimulation.skipped == {'steps of it are missing': 1}
    # up to there, and the episode behind it
    assert found.resimulation.frames == 5 + 13


def test_verify_says_what_of_episode_cannot_be_used(tmp_path, short):
    found = verified(with_odd(short, tmp_path / 'bag', '/episode', junk, at=1))
    assert found.problems == ['1 messages of episode cannot be used']
    assert found.resimulation.frames == 26


def test_info_says_how_many_steps_cannot_be_used(tmp_path, short):
    with BagReader(with_odd(short, tmp_path / 'bag', '/step', junk)) as reader:
        info = bag_info(reader)
    assert info['problems'] == ['1 messages of step cannot be used']
    assert info['whole_episodes'] == 2


def test_a_command_that_no_car_takes_ends_the_driving_of_its_episode_alone(tmp_path):
    found = falsified(tmp_path, 30, linear=1e30)
    assert found.problems == [
        '1 twists are not what step says was applied, the first before episode 1, decision 30',
        'episode 1, decision 30, step message 71, simulation time 3.40 s: '
        f'Command(linear=1e+30, angular={scripted(29).angular}) is beyond -1 to 1']
    assert found.resimulation.frames == 41 + 30


def test_a_bag_in_which_two_publish_under_one_stamp_is_not_good(tmp_path, short):
    def change(name, number, data):
        if name != '/step' or number != 10:
            return [data]
        held = decode_bundle(data, name)
        return [data, bundle(held.stamp, {**held.values_with(), 'reward': 5.0})]

    found = verified(changed(short, tmp_path / 'bag', change), resimulate=False)
    assert any('different messages of one stamp' in one for one in found.problems), found


def test_a_simulator_that_was_started_again_is_driven_again_from_its_start(tmp_path, short):
    def change(name, number, data):
        # the first run began before the recording
        if number < 5 and name != '/episode':
            return []
        if name == '/step' and number == 26 + 10:
            held = decode_bundle(data, name)
            data = bundle(held.stamp, {**held.values_with(), 'reward': 5.0})
        return [data]

    found = verified(changed(short, tmp_path / 'bag', change, times=2))
    assert found.transitions == {'joined': 7 + 12 + 24, 'rewound': 1}
    assert found.notes[0] == '1 x rewound when joining transitions'
    assert found.notes[1:] == ['1 episodes not driven again: begun before the recording']
    driven = found.resimulation
    assert (driven.episodes, driven.frames, driven.differing_rewards) == (3, 3 * 13, 1)
    assert len(found.problems) == 1 and 'episode 0, decision 10' in found.problems[0]


def test_no_more_of_a_stream_is_passed_over_than_all_episodes_may(tmp_path, monkeypatch):
    monkeypatch.setattr('bags.resimulate.MAX_STREAM', 8)
    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=1, settings={
        'seed_each_episode': False, 'first_episode': 9})
    recorder = DriveRecorder(tmp_path / 'falling')
    values = {**dict.fromkeys(STEP_CORE, 0), 'seed': -1, 'applied_sec': -1}
    for number in range(4):
        recorder.put(STEP, bundle(number * 10 ** 9, {**values, 'episode': 5 - number}))
        recorder.put(IMAGE, image(number * 10 ** 9, np.zeros((96, 96, 3), np.uint8)))
    recorder.writer.close()
    for folder, driven in ((bag, 0), (tmp_path / 'falling', 2)):
        found = verified(folder)
        # 5, then 3; neither 4 nor 2 more
        assert found.resimulation.episodes == driven
        assert found.notes[-1].endswith(
            ' episodes not driven again: more than 8 episodes of its stream would have to be '
            'passed over'), found.notes


@pytest.mark.parametrize('order', ['images first', 'images last', 'no image'])
def test_frames_are_whole_however_far_one_topic_is_behind_another(tmp_path, drive, order):
    recorder = DriveRecorder(tmp_path / 'bag')
    with BagReader(drive) as reader:
        images = [(IMAGE, bytes(one.data)) for one in reader.messages(['/image_raw'])]
        steps = [(STEP, bytes(one.data)) for one in reader.messages(['/step'])]
        values = [(Q_VALUES, bytes(one.data)) for one in reader.messages(['/q_values'])]
    if order == 'no image':
        images = [*images[:9], *images[10:]]
    later = steps + values
    for topic, data in later + images if order == 'images last' else images + later:
        recorder.put(topic, data)
    recorder.writer.close()
    with BagReader(tmp_path / 'bag') as reader:
        frames = list(recorded_frames(reader))
    assert [frame.number for frame in frames] == list(range(82))
    assert [frame.number for frame in frames if frame.pixels is None] == (
        [9] if order == 'no image' else [])
    # the last frame of an episode leads to no decision
    assert [frame.number for frame in frames if not frame.q_values] == [40, 81]


@pytest.mark.parametrize('settings', [
    {'action_repeat': 4, 'max_episode_frames': 90},
    {'seed_each_episode': False},
    {'seed_each_episode': False, 'first_episode': 2},
    {'zoom': False, 'domain_randomize': True},
    {'early_end_frames': 15, 'max_episode_frames': 1000},
])
def test_variants_are_driven_again_exactly(tmp_path, settings):
    found = verified(record_drive(tmp_path / 'bag', episodes=3, settings=settings))
    assert found.good, found.problems
    assert found.resimulation.episodes == 3


TOY = 'toy_simulator:Toy'


class Undetermined(toy_simulator.Toy):
    deterministic = False


def test_a_bag_of_any_simulator_is_driven_again_where_that_can_be(tmp_path):
    bag = record_drive(tmp_path / 'bag', settings={'simulator': TOY, 'action_repeat': 4})
    driven = verified(bag, simulator=TOY).resimulation
    assert (driven.episodes, driven.differing_frames) == (2, 0) and driven.frames > 10
    # a name out of a bag imports nothing, and no other simulator is taken for it
    for options, told in (
            ({}, "its simulator 'toy_simulator:Toy' is none of the installed"),
            ({'simulator': f'{__name__}:Undetermined'}, 'is not deterministic')):
        found = verified(bag, **options)
        assert found.good and found.resimulation.frames == 0
        assert any(told in note for note in found.notes), found.notes
    unnamed = record_drive(tmp_path / 'unnamed', settings={'simulator': TOY}, named=False)
    found = verified(unnamed)
    assert found.good and found.resimulation.frames == 0
    assert any('the bag names no simulator' in note for note in found.notes)
    assert verified(unnamed, simulator=TOY).resimulation.differing_frames == 0
    with pytest.raises(SimulatorError, match='accepted'):
        verified(bag, simulator='slow')


def test_a_bag_of_carracing_need_not_name_it(tmp_path):
    found = verified(record_drive(tmp_path / 'bag', named=False))
    assert found.good and found.resimulation.frames == 82


def test_an_episode_that_began_before_the_recording_is_passed_over(tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=3, skip_first=10,
                       settings={'seed_each_episode': False})
    found = verified(bag)
    assert found.good
    assert found.resimulation.episodes == 2
    assert found.notes == ['1 episodes not driven again: begun before the recording']


def falsified(tmp_path, decision, **changes):
    """Record a drive in which the second episode's frame of a decision is not what happened."""
    def change(frame):
        if frame.step.episode == 1 and frame.step.decision == decision:
            pixels = frame.pixels.copy()
            pixels[40, 50, 1] ^= changes.get('pixel', 0)
            values = {**frame.step.values(), **changes}
            values.pop('pixel', None)
            return dataclasses.replace(frame, pixels=pixels, step=read_step(values))
        return frame
    return verified(record_drive(tmp_path / 'bag', change=change))


def test_verify_finds_a_single_bit_of_a_single_pixel(tmp_path):
    found = falsified(tmp_path, 17, pixel=1)
    driven = found.resimulation
    assert (driven.differing_frames, driven.differing_images) == (1, 1)
    assert found.problems == [
        'episode 1, decision 17, step message 58, simulation time 3.14 s: image']


@pytest.mark.parametrize(('changes', 'told'), [
    ({'reward': -0.1000001}, 'reward -0.1000001 instead of'),
    ({'truncated': 1}, 'truncated'),
    ({'lap_finished': 1}, 'lap_finished'),
    ({'tiles_visited': 99}, 'tiles_visited'),
])
def test_verify_finds_a_wrong_number(tmp_path, changes, told):
    found = falsified(tmp_path, 30, **changes)
    assert found.resimulation.differing_frames == 1
    *others, problem = found.problems
    assert others == (
        ['1 steps come after the end of their episode'] if told == 'truncated' else [])
    assert told in problem and 'decision 30' in problem


def test_verify_finds_a_wrong_action_and_says_where_they_part(tmp_path):
    found = falsified(tmp_path, 20, angular=0.9)
    assert found.resimulation.differing_frames == 20 + 1
    assert found.problems[0].startswith('1 twists are not what step says was applied')
    assert 'decision 20' in found.problems[1]
    assert found.problems[2] == '20 more frames differ'


def test_verify_finds_a_wrong_seed(tmp_path):
    found = falsified(tmp_path, 0, seed=99)
    assert found.resimulation.differing_frames > 30
    assert 'decision 0' in found.problems[0]


def test_episodes_are_summed_up(tmp_path, drive):
    with BagReader(drive) as reader:
        first, second = find_episodes(reader)
    assert (first.number, first.seed, first.decisions, first.whole) == (0, 5, 40, True)
    assert (second.number, second.seed, second.truncated) == (1, 6, True)
    env = make_env(max_episode_steps=40)
    env.reset(seed=5)
    total = 0.0
    for number in range(40):
        total += env.step(controls(scripted(number)))[1]
    assert first.episode_return == total
    bag = record_drive(tmp_path / 'bag', skip_first=10)
    with BagReader(bag) as reader:
        assert [one.whole for one in find_episodes(reader)] == [False, True]


def test_info_is_json_and_a_table(drive, capsys):
    with BagReader(drive) as reader:
        info = bag_info(reader)
    assert info['messages'] == sum(topic['messages'] for topic in info['topics'])
    assert command('info', drive, '--json') == 0
    assert json.loads(capsys.readouterr().out) == info
    assert command('info', drive) == 0
    shown = capsys.readouterr().out
    for word in ('/image_raw', 'sensor_msgs/msg/Image', 'mcap', '2 whole',
                 'mean return', 'transient_local'):
        assert word in shown


def test_names_of_custom_data_are_not_taken_for_what_was_found(tmp_path, capsys):
    small_bag(tmp_path / 'bag', messages=10, custom_data={'messages': '7', 'problem 1': 'x'})
    assert command('info', tmp_path / 'bag') == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert 'messages     20' in lines
    assert lines[lines.index('custom_data') + 1:][:2] == ['  messages   7', '  problem 1  x']


def test_csv_has_a_row_per_frame_with_every_bit(tmp_path, drive):
    path = tmp_path / 'steps.csv'
    with BagReader(drive) as reader:
        assert export_csv(reader, path) == 82
        with pytest.raises(BagError, match='exists already'):
            export_csv(reader, path)
        with pytest.raises(BagError, match='has no episode 9'):
            export_csv(reader, tmp_path / 'none.csv', episode=9)
        assert not (tmp_path / 'none.csv').exists()
    rows = list(csv.DictReader(path.open()))
    transitions = list(bag_transitions([drive]))
    assert [float(row['reward']) for row in rows[1:41]] == [
        one.step.reward for one in transitions[:40]]
    assert rows[0]['q_right'] == '1.5'
    # the last frame of an episode leads to no decision
    assert rows[40]['q_right'] == ''
    assert rows[41]['decision'] == '0'


def test_csv_has_a_column_for_what_comes_late(tmp_path, drive, monkeypatch):
    bag = changed(drive, tmp_path / 'bag', lambda name, number, data: (
        [] if name == '/q_values' and number < 5 else [data]))
    with BagReader(bag) as reader:
        assert export_csv(reader, tmp_path / 'steps.csv') == 82
        monkeypatch.setattr('bags.export.MAX_COLUMNS', 30)
        with pytest.raises(BagError, match='has values of 32 names; accepted: up to 30'):
            export_csv(reader, tmp_path / 'many.csv')
    rows = list(csv.DictReader((tmp_path / 'steps.csv').open()))
    assert [row['q_right'] for row in rows[:7]] == [''] * 5 + ['1.5'] * 2


def test_video_shows_every_frame_for_as_long_as_it_lasted(tmp_path, drive):
    path = tmp_path / 'lap.mp4'
    with BagReader(drive) as reader:
        assert export_video(reader, path, episode=1, speed=2.0) == 41
        with pytest.raises(BagError, match='exists already'):
            export_video(reader, path)
        with pytest.raises(BagError, match='scale is 0; accepted: 1 to 20'):
            export_video(reader, tmp_path / 'x.mp4', scale=0)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert (stream.width, stream.height, len(frames)) == (704, 384, 41)
        assert frames[40].time - frames[0].time == pytest.approx(40 * 0.01, abs=1e-3)
        shown = frames[20].to_ndarray(format='rgb24')[:384:4, :384:4].astype(int)
    recorded = list(bag_transitions([drive]))[40 + 20].frame.astype(int)
    assert np.abs(shown - recorded).mean() < 12


def test_a_moving_picture_for_pages_plays_for_ever_and_as_long_as_the_lap(tmp_path, drive):
    path = tmp_path / 'lap.webp'
    with BagReader(drive) as reader:
        # 40 frames of 20 ms, ten pictures a second
        assert export_video(reader, path, episode=1) == 9
    with Image.open(path) as film:
        assert (film.n_frames, film.info['loop'], film.size) == (9, 0, (704, 384))


@pytest.mark.parametrize(('topic', 'values', 'longest'), [
    ('/q_values', {'left': float('nan'), 'chosen': float('nan')}, 0.5),
    ('/step', {'linear': 1e300}, 0.5),
    ('/step', {'frames': 1e300}, 20.0),
    ('/step', {'frames': -3.0}, 0.5),
    ('/episode', {'frame_seconds': 1e-6}, 5.0),
    ('/episode', {'frame_seconds': 1.0}, 1.0),
])
def test_a_video_is_made_of_any_numbers(tmp_path, short, topic, values, longest):
    bag = with_values(short, tmp_path / 'bag', topic, **values)
    with BagReader(bag) as reader:
        assert export_video(reader, tmp_path / 'lap.mp4', scale=1) == 26
    with av.open(str(tmp_path / 'lap.mp4')) as container:
        times = [frame.time for frame in container.decode(container.streams.video[0])]
    assert len(times) == 26
    apart = np.diff(times)
    assert apart.min() > 0 and apart.max() == pytest.approx(longest, abs=1e-3)


@pytest.mark.parametrize('limits', [(-1e308, 1e308), (0.0, 5e-324), (3.0, 3.0)])
def test_what_is_painted_stays_in_its_place_whatever_the_numbers(drive, limits):
    with BagReader(drive) as reader:
        frame = next(recorded_frames(reader))
    step = dataclasses.replace(
        frame.step, info={**frame.step.info, 'linear': -1e300, 'angular': -1e300})
    low, high = limits
    painted = FramePainter(96, 96, 4).paint(
        RecordedFrame(0, 0, step, None, {}),
        {'a': low, 'b': float('nan'), 'c': high, 'd': float('inf'), 'chosen': 2.0})
    # full brake is the whole width of the bars, the picture remains dark
    assert (painted[:, :384] == painted[0, 0]).all()
    assert (painted == BLUE).all(axis=2).any() and (painted == GREEN).all(axis=2).any()


@pytest.mark.parametrize(('count', 'chosen'), [(9, 8), (16, 3), (40, 25)])
def test_the_chosen_action_is_painted_however_many_there_are(drive, count, chosen):
    with BagReader(drive) as reader:
        frame = next(recorded_frames(reader))
    values = {f'action {number}': float(number % 7) for number in range(count)}
    painted = FramePainter(96, 96, 4).paint(frame, {**values, 'chosen': float(chosen)})
    assert (painted[210:, 560:] == GREEN).all(axis=2).any()


def test_what_a_killed_export_has_left_is_removed_by_the_next(tmp_path, drive):
    for name in ('.lap.csv.abcd1234', '.lap.csvx.abcd1234', '.other.csv.abcd1234'):
        (tmp_path / name).write_text('half')
    with BagReader(drive) as reader:
        export_csv(reader, tmp_path / 'lap.csv')
    assert sorted(path.name for path in tmp_path.glob('.*.abcd1234')) == [
        '.lap.csvx.abcd1234', '.other.csv.abcd1234']


@pytest.mark.parametrize(('ended', 'told'), [
    ('/image_raw', 'transitions lack an image'), ('/cmd_vel', 'lack the twist that was applied')])
def test_a_topic_that_ends_before_the_others_is_missed(tmp_path, drive, ended, told):
    with BagReader(drive) as reader, BagWriter(tmp_path / 'bag') as writer:
        topics = {name: writer.add_topic(name, topic.type_name, topic.qos)
                  for name, topic in reader.topics.items()}
        last = [one.log_time for one in reader.messages([ended])][-20]
        for one in reader.messages():
            if one.topic != ended or one.log_time < last:
                writer.write(topics[one.topic], one.log_time, one.publish_time, bytes(one.data))
    with BagReader(tmp_path / 'bag') as reader:
        found = verify_bag(reader, resimulate=False)
    assert any(told in problem for problem in found.problems), found


@pytest.fixture(scope='module')
def reset(tmp_path_factory):
    """Return a bag of three episodes of 20 decisions, the first two ended by resets after 12."""
    folder = tmp_path_factory.mktemp('reset') / 'bag'
    settings = {'seed': 5, 'seed_each_episode': True, 'max_episode_frames': 20}
    drive = open_drive(settings)
    recorder = DriveRecorder(folder, provenance={'simulator': settings})
    for number in range(3):
        frame = drive.begin()
        recorder.frame(frame)
        while not frame.step.ended:
            # the twist that was on its way answers no frame
            recorder.put(CMD_VEL, twist(frame.stamp, scripted(drive.decision)))
            if number < 2 and drive.decision == 12:
                recorder.put(EPISODE, bundle(drive.stamp, drive.abandon()))
                break
            frame = drive.advance(scripted(drive.decision), frame.stamp)
            recorder.frame(frame)
    recorder.writer.close()
    return folder


def test_an_episode_that_a_reset_ends_lacks_nothing(reset):
    found = verified(reset)
    assert found.good and not found.notes, found
    assert found.transitions == {'joined': 12 + 12 + 20}
    assert (found.resimulation.frames, found.resimulation.differing_frames) == (13 + 13 + 21, 0)
    console = Console(record=True, width=120)
    with BagReader(reset) as reader:
        show_info(bag_info(reader), console)
    told = console.export_text()
    assert told.count('reset, or its end') == 2 and 'after the bag' not in told


@pytest.mark.parametrize(('topic', 'kept', 'lost'), [
    # alone, on either side of a reset, and from there to the end
    ('/image_raw', lambda number: number != 5, {'lost_image': 2}),
    ('/image_raw', lambda number: number != 12, {'lost_image': 1}),
    ('/image_raw', lambda number: number != 13, {'lost_image': 1}),
    ('/image_raw', lambda number: number < 10, {'lost_image': 3 + 12 + 20}),
    ('/cmd_vel', lambda number: number != 12, {}),
    ('/cmd_vel', lambda number: number < 10, {'lost_twist': 2 + 12 + 20}),
])
def test_between_episodes_nothing_is_counted_as_lost(tmp_path, reset, topic, kept, lost):
    bag = changed(reset, tmp_path / 'bag', lambda name, number, data: (
        [data] if name != topic or kept(number) else []))
    counts = Counter()
    list(bag_transitions([bag], counts=counts))
    assert {name: count for name, count in counts.items() if count} == {
        'joined': 12 + 12 + 20 - sum(lost.values()), **lost}


def test_what_waits_for_images_is_counted_as_what_it_is(tmp_path, reset):
    def change(name, number, data):
        return [] if name == '/image_raw' and number >= 10 or (
            name == '/step' and number == 20) else [data]

    counts = Counter()
    list(bag_transitions([changed(reset, tmp_path / 'bag', change)], counts=counts))
    assert (counts['lost_step'], counts['lost_image']) == (1, 3 + 10 + 20)


def test_video_of_another_simulator_has_its_size_and_its_pace(tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=1, settings={'simulator': 'toy_simulator:Toy'})
    with BagReader(bag) as reader:
        pictures = export_video(reader, tmp_path / 'toy.mp4', scale=4)
        with pytest.raises(BagError, match='a frame of 48x32, 50 times|scale is 50'):
            export_video(reader, tmp_path / 'large.mp4', scale=50)
    with av.open(str(tmp_path / 'toy.mp4')) as container:
        frames = list(container.decode(container.streams.video[0]))
    assert len(frames) == pictures > 3
    # two rows of numbers and bars need more room than 4 x 32 rows
    assert (frames[0].width, frames[0].height) == (48 * 4 + 320, 384)
    assert frames[2].time - frames[1].time == pytest.approx(0.05, abs=1e-3)
    with BagReader(bag) as reader:
        recorded = [frame.pixels.astype(int) for frame in recorded_frames(reader)]
    shown = frames[1].to_ndarray(format='rgb24')[:128:4, :192:4].astype(int)
    assert np.abs(shown - recorded[1]).mean() < 12


def test_commands_answer_with_one_line_and_a_code(tmp_path, drive, capsys):
    assert command('verify', drive) == 0
    assert '2 episodes, 82 frames, 0 differ' in capsys.readouterr().out
    assert command('verify', drive, '--json') == 0
    assert json.loads(capsys.readouterr().out)['resimulation']['frames'] == 82
    data = (drive / 'bag_0.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(data[:-100])
    assert command('verify', tmp_path / 'cut.mcap') == 2
    assert command('recover', tmp_path / 'cut.mcap', tmp_path / 'out') == 0
    told = capsys.readouterr()
    assert told.err.startswith('error: ') and told.err.count('\n') == 1
    assert 'chunks saved to' in told.out
    assert command('verify', tmp_path / 'out') == 0
    for words in (['info', tmp_path / 'nothing'], ['export', drive],
                  ['recover', drive, tmp_path / 'out'],
                  ['export', drive, '--csv', tmp_path / 'no' / 'such.csv'],
                  ['record', tmp_path / 'new', '--compression', 'gzip'],
                  ['record', tmp_path / 'new', '--chunk-bytes', 'many'],
                  ['play', drive, '--rate', '-1']):
        capsys.readouterr()
        assert command(*words) == 2
        told = capsys.readouterr()
        assert told.err.startswith('error: ') and told.err.count('\n') == 1, words
    assert not (tmp_path / 'new').exists()


@pytest.mark.parametrize('decode', [decode_bundle, decode_image])
@pytest.mark.parametrize('junk', [b'', b'\0\1', b'\0\1\0\0' + bytes(7), b'\xff' * 64])
def test_bytes_that_are_no_message_are_an_error_of_the_bag(decode, junk):
    with pytest.raises(BagError):
        decode(junk, 'x')


def test_a_bag_of_version_0_1_is_verified_driven_again_and_learned_from():
    bag = Path(__file__).parent / 'data' / 'bag_of_0_1'
    found = verified(bag)
    assert found.good and found.resimulation.frames == 2 * 13
    assert found.resimulation.episodes == 2
    transitions = list(bag_transitions([bag]))
    assert [one.command for one in transitions[:12]] == [scripted(n) for n in range(12)]
    assert all(one.step.info['linear'] == one.command.linear for one in transitions)
    with BagReader(bag) as reader:
        assert [episode.seed for episode in find_episodes(reader)] == [5, 6]


@pytest.mark.parametrize(('name', 'value'), [
    ('seed', float('nan')), ('seed', 1e30), ('episode', 1e12), ('episode', 0.5),
    ('decision', -1.0), ('applied_sec', 1e12), ('reward', float('inf')), ('linear', 1e30),
    ('angular', -2.0), ('frames', 1e12), ('speed', float('nan')),
])
def test_no_odd_value_ends_a_command_with_more_than_a_line(tmp_path, capsys, name, value):
    def falsify(values):
        wrong = {name: value, **({'seed': -1.0} if name == 'episode' else {})}
        return {**values, **wrong} if values['decision'] in (0, 3) else values

    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=4, falsify=falsify)
    for words in (('info', bag), ('info', bag, '--json'), ('verify', bag)):
        assert command(*words) in (0, 1, 2)
    assert command('verify', bag) != 0
    assert 'Traceback' not in capsys.readouterr().err


@pytest.mark.parametrize('text', [
    '/[/x]', '/\x1b[31mred', '/' + 'x' * 100_000, '/\x1b]52;c;aGk=\a'])
@pytest.mark.parametrize('kind', ['std_msgs/msg/Bool', 'os/path/join', '\x1b[31m/msg/X', ''])
def test_no_text_of_a_bag_reaches_the_terminal_as_more_than_text(tmp_path, capsys, text, kind):
    with BagWriter(tmp_path / 'bag', custom_data={text: kind, 'simulator': '[' * 3000}) as writer:
        topic = writer.add_topic(text, kind, [], schema=Schema(kind, 'ros2msg', '', ''))
        writer.write(topic, 5, 5, b'\x00\x01\x00\x00\x01')
    for words in (('info',), ('verify',), ('export', '--csv', tmp_path / 'x.csv')):
        assert command(words[0], tmp_path / 'bag', *words[1:]) in (0, 1, 2)
    shown = capsys.readouterr()
    assert '\x1b' not in shown.out + shown.err and '\a' not in shown.out + shown.err
    assert max(map(len, (shown.out + shown.err).splitlines())) < 1000


@pytest.mark.parametrize('count', [2 ** 60, 2 ** 45])
def test_images_that_the_file_only_claims_to_have_are_refused(drive, count):
    with BagReader(drive) as reader:
        reader.topics['/image_raw'].message_count = count
        with pytest.raises(BagError, match=f'{count} images of 96x96 do not fit into memory'):
            load_images(reader)
