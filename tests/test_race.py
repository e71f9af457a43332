# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A person races a model: keys of a window, what it shows, the node, and the whole command."""
import io
import json
import math
import os
import signal
import sys
import tracemalloc

from bags.transitions import bag_transitions
from carracing_dqn.bringup.monitor import GraphState
from carracing_dqn.bringup.race_command import person_laps, race_table
from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.results import read_json, Results
from carracing_dqn.teleop.hand import DOWN, HeldKeys, Joystick, LEFT, RIGHT, UP
from carracing_dqn.teleop.race import Race, View
from carracing_dqn.teleop.rivals import read_rivals, Rival, write_rivals
from carracing_dqn.teleop.settings import RaceSettings
from graph_probe import carracing, start_carracing
from learning_cases import make_step
from msgs_bridge import topics
from msgs_bridge.errors import SettingsError
from msgs_bridge.images import fill_image
from msgs_bridge.twists import Command, STOP
import numpy as np
import pytest
from rich.console import Console
from sensor_msgs.msg import Image, Joy

SETTINGS = RaceSettings()
RIVAL = Rival(420, [0.0, 3.0, 6.0, 9.0], [0, 1, 1, 3], True)


def test_held_keys_steer_further_the_longer_and_take_gas_away():
    keys = HeldKeys(SETTINGS)
    assert keys.command(0.0) == STOP
    keys.press(UP)
    assert keys.command(0.02) == Command(SETTINGS.gas, 0.0)
    keys.press(LEFT)
    first, second = keys.command(0.04), keys.command(0.06)
    assert 0 < first.angular < second.angular < SETTINGS.steering
    assert SETTINGS.gas > first.linear > second.linear
    # a pause counts for little, and more than all there is none
    assert keys.command(9.0).angular < SETTINGS.steering
    for number in range(20):
        held = keys.command(9.0 + 0.02 * number)
    assert held == (pytest.approx(SETTINGS.gas * SETTINGS.gas_in_bends), SETTINGS.steering)
    keys.release(LEFT)
    keys.press(RIGHT)
    assert -SETTINGS.steering < keys.command(9.4).angular < 0
    keys.press(LEFT)
    assert keys.command(9.42).angular == 0
    keys.press(DOWN)
    assert keys.command(9.44).linear == -SETTINGS.brake
    keys.release_all()
    keys.release(UP)
    assert keys.command(9.46) == STOP


def step(frames, **changes):
    return make_step(seed=420, decision=frames, step=frames, episode_return=2.0 * frames,
                     tiles_visited=frames // 2, **changes)


def test_a_race_is_told_beside_the_model():
    race = Race(2, 'racing', {420: RIVAL})
    assert race.view().title == 'waiting for the simulator' and race.under_way == {}
    race.take(step(0, episode=5), 10**9)
    assert race.view().call == 'press gas to start' and race.under_way == {}
    assert race.view().title == 'lap 1 of 2, track 420'
    race.started = True
    race.take(step(2, episode=5), 10**9 + 40_000_000)
    view = race.view()
    rows = {name: (mine, theirs) for name, mine, theirs in view.rows}
    assert view.call == '' and rows[''] == ('you', 'racing')
    assert rows['time'] == ('0.04 s', '') and rows['return'] == ('4.0', '6.0')
    assert rows['tiles'] == ('1/300', '1/300')
    # the model had this tile after one frame
    assert rows['gap'] == ('+0.02 s', '')
    assert race.under_way == {'seed': 420, 'episode_return': 4.0, 'step': 2, 'tiles_visited': 1,
                              'tiles_total': 300}
    race.take(step(3, episode=5, terminated=1.0, lap_finished=1.0), 10**9 + 60_000_000)
    assert race.view().results == ('track 420: 6.0, finished, racing 9.0',)
    assert race.under_way == {} and race.view().call == 'press gas to start'
    race.take(make_step(seed=421, episode=6), 2 * 10**9)
    # without a lap of the model there is nothing beside
    assert race.view().title == 'lap 2 of 2, track 421' and not race.started
    assert all(theirs == '' for _, _, theirs in race.view().rows)
    race.take(make_step(seed=421, episode=6, decision=1, truncated=1.0), 3 * 10**9)
    assert race.view().call == 'end of the race'
    # a simulator that was started again counts from 0
    race.take(step(0, episode=0), 10**9)
    assert race.lap == 1


def test_of_a_race_without_an_end_only_what_is_shown_is_kept():
    race = Race()
    tracemalloc.start()
    try:
        for episode in range(3000):
            race.take(step(3, episode=episode, terminated=1.0), episode)
            if episode == 100:
                before, _ = tracemalloc.get_traced_memory()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(race.view().results) == 5 and after - before < 20_000


def test_laps_of_the_model_travel_and_nothing_else_is_taken(tmp_path):
    path = tmp_path / 'rivals.json'
    write_rivals(path, 'racing', [RIVAL])
    assert read_rivals(path) == ('racing', {420: RIVAL})
    assert RIVAL.at(99) == (9.0, 3) and RIVAL.at(-1) == (0.0, 0)
    assert RIVAL.frames_for(2) == 3 and RIVAL.frames_for(4) is None
    for text in ('', '[]', '{"name": "x", "laps": [{}]}', '{"name": "x"}',
                 json.dumps({'name': 'x', 'laps': [
                     {'seed': 1, 'returns': [0], 'tiles': [], 'finished': True}]})):
        path.write_text(text)
        with pytest.raises(SettingsError, match='no laps to race against'):
            read_rivals(path)
    lap = {'seed': 1, 'returns': [0.0, 1.0], 'tiles': [0, 1], 'finished': True}
    for odd in ({'returns': [0.0, math.nan]}, {'returns': [0.0, math.inf]}, {'tiles': [3, 1]}):
        path.write_text(json.dumps({'name': 'x', 'laps': [{**lap, **odd}]}))
        with pytest.raises(SettingsError, match='no laps to race against'):
            read_rivals(path)
    # a name is shown in the window
    path.write_text(json.dumps({'name': 'a\0b\udc00' + 'x' * 9999, 'laps': [lap]}))
    assert read_rivals(path)[0] == 'a?b?' + 'x' * 95 + '…'
    with pytest.raises(SettingsError, match='no such file'):
        read_rivals(tmp_path / 'nowhere')


@pytest.fixture
def window(monkeypatch):
    monkeypatch.setenv('SDL_VIDEODRIVER', 'dummy')
    from carracing_dqn.teleop.race_window import RaceWindow
    window = RaceWindow(4, 'test')
    yield window
    window.close()


def test_the_window_takes_keys_and_shows_the_picture(window):
    import pygame
    keys, joystick = HeldKeys(SETTINGS), Joystick(SETTINGS)

    def post(kind, **values):
        pygame.event.post(pygame.event.Event(kind, values))
        return window.poll(keys, joystick, 0.0)

    assert not post(pygame.KEYDOWN, key=pygame.K_w)
    assert not post(pygame.KEYDOWN, key=pygame.K_x)
    assert keys.command(0.0).linear == 1
    assert not post(pygame.KEYUP, key=pygame.K_w)
    assert keys.command(0.0) == STOP
    post(pygame.KEYDOWN, key=pygame.K_UP)
    post(pygame.WINDOWFOCUSLOST)
    assert keys.command(0.0) == STOP
    view = View('lap 1', (('time', '1.00 s', ''), ('return', '3.0', '4.0')), ('track 1',), '')
    pixels = np.zeros((96, 96, 3), np.uint8)
    pixels[10, 20] = 10, 200, 30
    window.show(None, 0, view)
    window.show(pixels, 1, view)
    screen = pygame.display.get_surface()
    assert screen.get_at((20 * 4 + 2, 10 * 4 + 2))[:3] == (10, 200, 30)
    panel = pygame.surfarray.array3d(screen)[96 * 4:]
    assert len(np.unique(panel.reshape(-1, 3), axis=0)) > 5
    # another camera has another size
    window.show(np.full((60, 80, 3), 9, np.uint8), 2, view)
    assert pygame.display.get_surface().get_at((79 * 4, 59 * 4))[:3] == (9, 9, 9)
    # a joystick that was pulled out before anybody looked
    assert not post(pygame.JOYDEVICEADDED, device_index=7)
    assert post(pygame.KEYDOWN, key=pygame.K_ESCAPE)
    assert post(pygame.QUIT)


@pytest.mark.parametrize('size', [(4096, 4096), (4096, 1), (1, 4096), (1100, 1000)])
def test_a_picture_of_any_size_fits_into_the_window(window, size):
    import pygame
    pixels = np.full((*size, 3), 9, np.uint8)
    pixels[-1, -1] = 200, 100, 50
    window.show(pixels, 1, View('lap 1', (), (), 'press gas to start'))
    screen = pygame.display.get_surface()
    assert max(screen.get_size()) <= 4096 + 400
    width = screen.get_width() - 400
    height = max(1, round(size[0] * width / size[1]))
    assert max(width, height) in (4096, 4400), 'as large as may be, or four to a pixel'
    assert screen.get_at((width - 1, height - 1))[:3] == (200, 100, 50)


def test_without_a_screen_it_is_one_line(tmp_path):
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('DISPLAY', 'WAYLAND_DISPLAY', 'SDL_VIDEODRIVER')}
    done = carracing('race', '--output', str(tmp_path / 'out'), env=environment)
    assert done.returncode == 2 and done.stderr.startswith('error: no screen for a window')
    assert done.stderr.count('\n') == 1 and not (tmp_path / 'out').exists()


@pytest.mark.parametrize('words', [('--laps', '0'), ('--speed', 'nan'), ('--scale', '99'),
                                   ('--seed', '-1'), ('--model', 'nobody')])
def test_wrong_options_are_one_line(words, tmp_path):
    done = carracing('race', *words, '--output', str(tmp_path / 'out'),
                     env={**os.environ, 'SDL_VIDEODRIVER': 'dummy'})
    assert done.returncode == 2 and done.stderr.startswith('error: ')
    assert done.stderr.count('\n') == 1 and not (tmp_path / 'out').exists()


def test_laps_and_the_one_that_was_left_stand_beside_the_models():
    state = GraphState()
    state.health['/race_node'] = {'seed': '421', 'episode_return': '12.5', 'step': '60',
                                  'tiles_visited': '5', 'tiles_total': '300'}
    state.episodes.append({'seed': 420.0, 'episode_return': 900.0, 'step': 700.0,
                           'lap_finished': 1.0, 'left_field': 0.0})
    # of a stranger, in the namespace of the race
    for odd in ({'seed': 7.0}, {'seed': 422.0, 'step': math.nan}, {'seed': 422.0, 'step': 0.0}):
        state.episodes.append({'episode_return': 1.0, **odd})
    laps = person_laps(state, range(420, 423))
    assert sorted(laps) == [420, 421]
    assert laps[420] == Lap(420, 900.0, 700, lap_finished=True, left_field=False)
    assert laps[421] == Lap(421, 12.5, 60, 5, 300, lap_finished=False)
    model = Results({}, 'carracing', {seed: Lap(
        seed, 920.0, 650, 300, 300, True, False, 0) for seed in (420, 421, 422)})
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(race_table(Results({}, 'graph', laps), model, 'racing'))
    said = console.export_text()
    assert 'given up' in said and said.count('lap finished') == 3 and '456.2' in said
    state.health.clear()
    assert list(person_laps(state, range(420, 423))) == [420]
    state.health['/race_node'] = {'seed': '421', 'step': 'inf', 'episode_return': 'nan'}
    assert list(person_laps(state, range(420, 423))) == [420]


# presses gas, steers, and leaves by Escape, by how far it has driven
TYPIST = """
import sys, threading, time
from carracing_dqn.teleop import race_node
take, taken = race_node.Race.take, []
def counted(race, step, stamp):
    taken.append(step)
    take(race, step, stamp)
race_node.Race.take = counted
def type_keys():
    import pygame
    for steps, seconds, kind, key in ((1, 3, pygame.KEYDOWN, pygame.K_UP),
                                      (50, 0, pygame.KEYDOWN, pygame.K_a),
                                      (120, 0, pygame.KEYDOWN, pygame.K_ESCAPE)):
        while len(taken) < steps:
            time.sleep(0.05)
        time.sleep(seconds)
        pygame.event.post(pygame.event.Event(kind, key=key))
threading.Thread(target=type_keys, daemon=True).start()
sys.exit(race_node.main())
"""


def test_keys_of_the_window_drive_a_simulator_and_escape_says_how_far_it_was(graph, monkeypatch):
    monkeypatch.setenv('SDL_VIDEODRIVER', 'dummy')
    graph.listen(topics.IMAGE, topics.CMD_VEL, topics.STEP, topics.DIAGNOSTICS)
    graph.node('carracing_sim_node', 'simulator', wait_for_subscribers=1)
    race = graph.start('race', [
        sys.executable, '-c', TYPIST, '--ros-args', '-r',
        f'__ns:=/{graph.namespace}'])
    graph.spin_until(lambda: graph.messages['step'], 120, 'the first frame')
    graph.spin(1.0)
    # nobody has pressed anything: the lap waits
    assert len(graph.messages['step']) == 1 and not graph.messages['cmd_vel']
    graph.spin_until(lambda: race.code is not None, 120, 'the end')
    assert race.code == 0
    graph.spin(0.5)
    transitions, joiner = graph.join()
    assert len(transitions) > 50 and not joiner.counts['lost_twist']
    commands = [one.command for one in transitions]
    assert commands[5] == Command(1.0, 0.0)
    assert commands[-1].angular == pytest.approx(0.4) and commands[-1].linear < 0.5
    last = graph.health('race_node')
    assert last['leaving'] == '1'
    driven = transitions[-1].step
    assert float(last['step']) == pytest.approx(driven.info['step'], abs=1)
    assert float(last['episode_return']) == pytest.approx(driven.episode_return, abs=0.5)


def test_images_without_steps_are_no_race_and_it_is_said(graph, monkeypatch):
    monkeypatch.setenv('SDL_VIDEODRIVER', 'dummy')
    graph.listen(topics.DIAGNOSTICS)
    images = graph.publisher(topics.IMAGE)
    graph.node('carracing_dqn.teleop.race_node', 'race_node')
    graph.spin_until(images.get_subscription_count, 60, 'the window')
    images.publish(fill_image(Image(), np.zeros((96, 96, 3), np.uint8), 10**9, 'camera'))
    graph.spin_until(lambda: 'images come, but no step' in graph.health('race_node').get(
        'summary', ''), 30, 'what is missing')


def test_a_race_is_driven_recorded_and_counted(graph, monkeypatch, tmp_path):
    monkeypatch.setenv('SDL_VIDEODRIVER', 'dummy')
    out = tmp_path / 'out'
    joy = graph.publisher(topics.JOY)
    graph.listen(topics.EPISODE, topics.STEP)
    process = start_carracing('race', '--laps', '2', '--seed', '420', '--speed', '5', '--output',
                              str(out), '--namespace', graph.namespace)
    try:
        def push():
            # in circles, to the end of the first lap and into the second
            joy.publish(Joy(axes=[0.2, 0.5]))
            graph.spin(0.05)
            if not graph.messages['step']:
                return False
            step = graph.messages['step'][-1]
            values = dict(zip(step.name, step.position))
            return values['episode'] >= 1 and values['decision'] > 100
        graph.spin_until(push, 300, 'a lap and a part')
        # it ends four seconds after its beginning, and is told of once a second
        graph.spin(1.5)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[0]
    finally:
        process.kill()
    assert process.returncode == 130, said
    person, model = (read_json(out / f'{name}.json') for name in ('person', 'model'))
    assert person.policy['kind'] == 'person' and model.policy['kind'] == 'model'
    assert sorted(person.laps) == [420, 421] and len(model.laps) == 2
    assert person.laps[420].frames == 1000 and person.laps[421].frames > 50
    assert 'you and racing' in said and 'given up' in said
    name, rivals = read_rivals(out / 'rivals.json')
    assert name == 'racing' and rivals[420].returns[-1] == pytest.approx(
        model.laps[420].episode_return)
    # the bag is one like that of any policy
    transitions = list(bag_transitions([out / 'bag'], namespace=f'/{graph.namespace}'))
    assert len(transitions) >= person.laps[420].frames + person.laps[421].frames
    first = [one for one in transitions if one.step.episode == 0]
    assert len(first) == 1000
    assert first[-1].step.episode_return == pytest.approx(
        person.laps[420].episode_return, abs=1e-6)
    assert first[50].command.linear == pytest.approx((0.5 - 0.05) / 0.95)
