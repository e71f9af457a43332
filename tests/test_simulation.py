# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators by name, their episodes, and when they go on; without ROS."""
from collections import Counter, deque
import dataclasses
import decimal
import fractions
import itertools

from hypothesis import given, settings, strategies
import numpy as np
import pytest

from carracing_dqn.simulation import find_simulator, make_simulator, open_drive, simulator_names
from carracing_dqn.simulation import registry
from carracing_dqn.simulation.drive import Drive
from carracing_dqn.simulation.settings import node_settings, settings_for, SimulationSettings
from carracing_dqn.simulation.stepping import Lockstep, RealTime
from carracing_dqn.simulation.track_retries import LEAST, TrackRetries
from carracing_sim_node import info_fields, make_env
from carracing_sim_node.controls import controls
from msgs_bridge.errors import MessageError, SettingsError, SimulatorError
from msgs_bridge.settings import describe, setting
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import EPISODE_CORE, MAX_SECONDS, read_step, STEP_INFO
from msgs_bridge.twists import Command, STOP
import toy_simulator

TOY = 'toy_simulator:Toy'


# Which simulator. --------------------------------------------------------------------------------

def test_simulators_are_found_by_name_or_place():
    assert {'carracing', 'fast', 'gymnasium'} <= set(simulator_names())
    assert find_simulator('fast') is find_simulator('carracing')
    assert find_simulator(TOY) is toy_simulator.Toy


@pytest.mark.parametrize(('name', 'told'), [
    ('slow', 'accepted: carracing, carracing_colours, '), ('', 'accepted'),
    ('no_such_module:Toy', 'cannot import'), (':Toy', 'cannot import'),
    ('toy_simulator:Nothing', "has no 'Nothing'"), ('toy_simulator:', "has no ''"),
    ('toy_simulator:HEIGHT', 'reset'), ('collections:Counter', 'reset, advance'),
    ('x' * 10_000, 'accepted')])
def test_what_is_no_simulator_is_refused_in_one_line(name, told):
    with pytest.raises(SimulatorError, match=told) as caught:
        find_simulator(name)
    assert len(str(caught.value)) < 400 and '\n' not in str(caught.value)


def test_names_from_a_file_import_nothing():
    with pytest.raises(SimulatorError, match='accepted'):
        find_simulator(TOY, registered_only=True)
    assert find_simulator('carracing', registered_only=True)


def test_another_package_offers_its_simulators_in_its_metadata(tmp_path, monkeypatch):
    metadata = tmp_path / 'somebody-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: somebody\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(
        f'[carracing_dqn.simulators]\ntoy = {TOY}\ncarracing = {TOY}\n')
    monkeypatch.syspath_prepend(tmp_path)
    registry._registered.cache_clear()
    try:
        assert find_simulator('toy', registered_only=True) is toy_simulator.Toy
        # a name of ours stays ours
        assert find_simulator('carracing') is not toy_simulator.Toy
        assert 'toy' in simulator_names()
    finally:
        registry._registered.cache_clear()


@dataclasses.dataclass(frozen=True)
class Own:
    action_repeat: int = setting(3, 'another default', low=1, high=50)
    hue: float = setting(0.5, 'one of its own', low=0.0, high=1.0)


class Hued(toy_simulator.Toy):
    Settings = Own


class Clashing(toy_simulator.Toy):
    Settings = dataclasses.make_dataclass(
        'Settings', [('seed', str, setting('x', 'not what the node means'))], frozen=True)


def test_a_simulator_brings_its_settings():
    known = describe(settings_for(f'{__name__}:Hued'))
    assert known['hue'][1] == 0.5 and known['action_repeat'][1] == 3 and 'seed' in known
    assert describe(node_settings())['max_episode_frames'][1] == 1000
    assert issubclass(node_settings({'simulator': TOY}), SimulationSettings)
    with pytest.raises(SettingsError, match="setting 'seed' that is not the node's"):
        settings_for(f'{__name__}:Clashing')
    with pytest.raises(SettingsError, match="did you mean 'hue'"):
        make_simulator(f'{__name__}:Hued', {'hew': 0.1})
    with pytest.raises(SettingsError, match='must be a text'):
        node_settings({'simulator': 5})


# CarRacing as one. -------------------------------------------------------------------------------

def test_carracing_is_the_environment(tmp_path):
    simulator = make_simulator('carracing', {'max_episode_frames': 150, 'zoom': False})
    env = make_env(action_repeat=4, max_episode_steps=150, zoom=False)
    assert set(simulator.constants) == set(info_fields.CONSTANTS)
    for episode in range(2):
        seed = None if episode else 9
        outcome = simulator.reset(seed)
        frame, _ = env.reset(seed=seed)
        assert set(outcome.info) == set(info_fields.STEP_INFO)
        for number in itertools.count():
            assert np.array_equal(outcome.pixels, frame)
            facts = env.facts()._asdict()
            assert all(facts[name] == value for name, value in outcome.info.items()
                       if name in facts)
            if outcome.terminated or outcome.truncated:
                break
            command = Command(0.5 if number % 9 else -0.2, 0.3 * (number % 3 - 1))
            outcome = simulator.advance(command, 4)
            frame, reward, terminated, truncated, info = env.step(controls(command))
            assert outcome[1:4] == (reward, terminated, truncated)
            assert outcome.frames == info['frames']
        assert outcome.truncated


def test_gymnasiums_own_gives_the_same_outcomes():
    ours = make_simulator('fast', {'max_episode_frames': 40})
    theirs = make_simulator('gymnasium', {'max_episode_frames': 40})
    for outcome, other in ((ours.reset(5), theirs.reset(5)),
                           *((ours.advance(command, 3), theirs.advance(command, 3))
                             for command in [Command(1.0, 0.4), Command(-1.0, -1.0)] * 7)):
        assert np.array_equal(outcome.pixels, other.pixels)
        assert outcome[1:4] == other[1:4] and outcome.frames == other.frames
        assert other.info.items() <= outcome.info.items()
    assert other.truncated and other.frames == 1


def test_leaving_the_field_is_no_finished_lap():
    simulator = make_simulator('carracing')
    outcome = simulator.reset(6)
    while not outcome.terminated:
        outcome = simulator.advance(Command(1.0, 0.0), 10, draw=False)
    assert outcome.info['left_field'] and not outcome.info['lap_finished']
    assert outcome.pixels is None and outcome.reward < -90


# Episodes. ---------------------------------------------------------------------------------------

def frames_of(drive, episodes):
    for _ in range(episodes):
        frame = drive.begin()
        yield frame
        while not frame.step.ended:
            frame = drive.advance(Command(0.0, 0.5), frame.stamp)
            yield frame


def test_a_toy_needs_no_more_than_a_core():
    frames = list(frames_of(open_drive({'simulator': TOY, 'action_repeat': 4}), 3))
    for before, frame in itertools.pairwise(frames):
        step = read_step(frame.step.values())
        assert set(step.info) == set(STEP_INFO)
        if step.decision:
            assert frame.stamp - before.stamp == step.info['frames'] * 50_000_000
            assert step.applied == before.stamp
            assert step.episode_return == pytest.approx(
                before.step.episode_return + step.reward)
        else:
            assert frame.stamp - before.stamp >= 10**9
            assert frame.episode['truncated'] == frame.episode['terminated'] == 0
            assert frame.episode['frame_seconds'] == 0.05 and frame.episode['decisions'] == 0
        assert (frame.episode is not None) == (step.decision == 0 or step.ended)
        assert frame.episode is None or set(EPISODE_CORE) <= set(frame.episode)
    assert [frame.step.seed for frame in frames if frame.step.decision == 0] == [42, -1, -1]


def test_seeds_streams_and_episodes_that_are_passed_over():
    def starts(**values):
        drive = open_drive({'simulator': TOY, **values})
        return [(frame.step.episode, frame.step.seed, frame.pixels.tobytes())
                for frame in frames_of(drive, 4) if frame.step.decision == 0]

    each = starts(seed_each_episode=True, seed=7)
    assert [one[:2] for one in each] == [(n, 7 + n) for n in range(4)]
    assert starts(seed_each_episode=True, seed=7, first_episode=2)[:2] == each[2:]
    stream = starts(seed=7)
    assert starts(seed=7, first_episode=1)[:3] == stream[1:]
    assert stream[0][2] == each[0][2] and stream[1][2] != each[1][2]


def test_only_what_went_worse_than_most_is_driven_again_and_not_for_ever():
    retries = TrackRetries(3)
    assert not any(retries.again(float(number)) for number in range(LEAST, 0, -1))
    assert [retries.again(-1.0) for _ in range(4)] == [True, True, True, False]
    assert [retries.again(value) for value in (-1.0, 15.0, 15.0)] == [True, False, False]
    # tracks that were retried have counted once each, and not set what is low
    assert retries.again(0.5)
    assert not any(TrackRetries(0).again(float(number)) for number in range(100, 0, -1))


def test_a_track_that_went_badly_comes_again_with_its_seed():
    drive = open_drive({'simulator': TOY, 'seed_each_episode': True, 'seed': 7,
                        'track_retries': 2})
    lanes = {}
    again = 0
    for _ in range(120):
        before, frame = drive.seed, drive.begin()
        assert frame.step.seed in (before, 7 + drive.episode)
        again += frame.step.seed == before
        lanes.setdefault(frame.step.seed, []).append(frame.pixels.tobytes())
        while not frame.step.ended:
            # straight on earns nothing, to the left half of the time
            frame = drive.advance(Command(0.0, float(drive.episode % 2)), None)
    assert 5 < again < 60
    assert all(len(set(starts)) == 1 and len(starts) <= 3 for starts in lanes.values())


def test_passing_over_takes_no_longer_than_it_is_given():
    drive = open_drive({'simulator': TOY, 'first_episode': 10**9})
    left = drive.skip_for(0.01)
    assert 10**9 - 10**5 < left < 10**9 and drive.skip_for(0.0) == left


class Unseeded(toy_simulator.Toy):
    seeded = False

    def reset(self, seed):
        assert seed is None
        return super().reset(seed)


def test_a_simulator_that_obeys_no_seed_gets_none():
    frames = list(frames_of(open_drive(
        {'simulator': f'{__name__}:Unseeded', 'seed_each_episode': True, 'first_episode': 5}), 2))
    assert {frame.step.seed for frame in frames} == {-1} and frames[0].step.episode == 5


def test_an_episode_that_is_left_has_been_cut_off():
    drive = open_drive({'simulator': TOY})
    assert drive.abandon() is None
    drive.begin()
    frame = drive.advance(STOP, None)
    left = drive.abandon()
    assert (left['decisions'], left['truncated'], left['terminated']) == (1, 1, 0)
    assert left['unanswered'] == 1 and left['step'] == 1 and drive.abandon() is None
    with pytest.raises(SimulatorError, match='no episode is running'):
        drive.advance(STOP, None)
    assert drive.begin().stamp > frame.stamp


PIXELS = np.zeros((32, 48, 3), np.uint8)


class Odd(Simulator):
    """Gives what it was told to."""

    frame_seconds = 0.05
    constants = {'constant': 3.0}

    def __init__(self, outcomes):
        self.outcomes = deque(outcomes)

    def reset(self, seed):
        return self.outcomes.popleft()

    def advance(self, command, frames=1):
        return self.outcomes.popleft()


@pytest.mark.parametrize(('outcomes', 'told'), [
    ([Outcome(PIXELS[..., 0])], r'pixels of \(32, 48\)'),
    ([Outcome(PIXELS.tolist())], 'pixels of list'),
    ([Outcome(PIXELS.astype(float))], 'pixels of float64'),
    ([Outcome(np.zeros((2, 5000, 3), np.uint8))], '5000'),
    ([Outcome(PIXELS), Outcome(PIXELS[1:], frames=1)], 'as before'),
    ([Outcome(PIXELS), Outcome(PIXELS, float('nan'), frames=1)], 'the reward nan'),
    ([Outcome(PIXELS), Outcome(PIXELS, 'much', frames=1)], 'the reward much'),
    ([None], 'a NoneType; expected an Outcome'),
    ([Outcome(PIXELS), Outcome(PIXELS)], '0 frames passed'),
    ([Outcome(PIXELS), Outcome(PIXELS, frames='one')], 'one frames passed'),
    ([], r'failed in reset: IndexError: .* \(test_simulation.py, line'),
    ([Outcome(PIXELS)], r'failed in advance: IndexError: .* \(test_simulation.py, line'),
    ([Outcome(PIXELS), Outcome(PIXELS, frames=3)], '3 frames passed; asked for 2'),
    ([Outcome(PIXELS, info={'speed': float('inf')})], "info 'speed' inf"),
    ([Outcome(PIXELS, info={'gear': 'first'})], "info 'gear' first"),
    ([Outcome(PIXELS, info={'gear': 10**400})], "info 'gear' 1000"),
    ([Outcome(PIXELS, info={'reward': 1.0})], 'means something else'),
    ([Outcome(PIXELS, info={'decisions': 1.0})], 'means something else'),
    ([Outcome(PIXELS, info={'constant': 1.0})], 'means something else'),
    ([Outcome(PIXELS), Outcome(PIXELS, frames=np.array([1, 1]))], 'frames passed; asked for 2'),
    ([Outcome(PIXELS), Outcome(PIXELS, np.zeros(2), frames=1)], 'accepted: a number'),
    ([Outcome(PIXELS, info=None)], 'as info None; expected names and numbers'),
    ([Outcome(PIXELS, info=[('a', 1)])], 'as info'),
    ([Outcome(PIXELS, info={1: 1.0})], "an info '1'; expected a name"),
    ([Outcome(PIXELS, info={'a' * 101: 1.0})], 'up to 100 letters'),
    ([Outcome(PIXELS, info={'\udcff': 1.0})], 'expected a name'),
    ([Outcome(PIXELS, info={f'a{n}': 1.0 for n in range(239)})], '240 values; accepted: up to'),
    ([Outcome(PIXELS), Outcome(PIXELS, 1e12, frames=1)], 'the reward 1000000000000.0; accepted'),
    ([Outcome(PIXELS), Outcome(PIXELS, 10**5000, frames=1)], 'the reward of type int'),
    ([Outcome(PIXELS), *2 * [Outcome(PIXELS, 9e8, frames=1)]], r'add up to 1.8e\+09'),
    ([Outcome(PIXELS), Outcome(PIXELS, 0.0, PIXELS, frames=1)], 'gives terminated'),
    ([Outcome(PIXELS, info={'a': 1}), Outcome(PIXELS, frames=1)], 'now and then')])
def test_what_a_simulator_does_not_owe_is_named(outcomes, told):
    drive = Drive(Odd(outcomes), SimulationSettings(simulator='odd', action_repeat=2))
    with pytest.raises(SimulatorError, match=told) as caught:
        for number in range(len(outcomes) + 1):
            drive.advance(STOP, None) if number else drive.begin()
    assert str(caught.value).startswith("simulator 'odd' ")


@pytest.mark.parametrize(('name', 'value', 'told'), [
    ('frame_seconds', 0, 'frame_seconds'), ('frame_seconds', 'fast', 'frame_seconds'),
    ('constants', {'seed': 1.0}, 'means something else'), ('constants', {'a': None}, 'constant'),
    ('constants', None, 'as constant None'),
    ('constants', {f'a{n}': 1 for n in range(240)}, '240 values')])
def test_what_is_wrong_from_the_start_is_said_at_the_start(name, value, told):
    simulator = Odd([])
    setattr(simulator, name, value)
    with pytest.raises(SimulatorError, match=told):
        Drive(simulator, SimulationSettings())


@pytest.mark.parametrize('number', [
    np.float16, np.float32, np.int8, fractions.Fraction, decimal.Decimal])
def test_a_return_is_as_exact_as_python_adds_whatever_numbers_a_simulator_has(number):
    rewards = [number(1 if number is np.int8 else 0.1)] * 5000
    drive = Drive(Odd([Outcome(PIXELS), *(
        Outcome(PIXELS, reward, np.False_, np.False_, frames=np.int64(1)) for reward in rewards)]),
        SimulationSettings(simulator='odd'))
    drive.begin()
    for _ in rewards:
        frame = drive.advance(STOP, None)
    assert frame.step.episode_return == pytest.approx(sum(map(float, rewards)))
    assert type(frame.step.episode_return) is type(frame.step.reward) is float
    assert frame.step.info['step'] == 5000 and type(frame.step.info['step']) is int


class Redrawing(toy_simulator.Toy):
    """Draws into one array, and reads its speed off another."""

    frame_seconds = np.float32(0.05)

    def __init__(self, settings):
        super().__init__(settings)
        self.drawn, self.speed = np.zeros((32, 48, 3), np.uint8), np.zeros(())

    def pixels(self):
        self.drawn[:] = super().pixels()
        return self.drawn

    def reset(self, seed):
        return super().reset(seed)._replace(info={'speed': self.speed})

    def advance(self, command, frames=1):
        self.speed += 1
        return super().advance(command, frames)._replace(info={'speed': self.speed})


def test_frames_that_are_kept_do_not_change_when_the_simulator_draws_again():
    frames = list(frames_of(open_drive({'simulator': f'{__name__}:Redrawing'}), 2))
    expected = list(frames_of(open_drive({'simulator': TOY}), 2))
    assert len(frames) == len(expected) > 10
    for number, (frame, wanted) in enumerate(zip(frames, expected)):
        assert np.array_equal(frame.pixels, wanted.pixels)
        assert frame.step.info['speed'] == number - frame.step.episode
    assert frames[0].episode['frame_seconds'] == pytest.approx(0.05)


class Left(toy_simulator.Toy):
    """Notes that it was closed, and cannot be."""

    frame_seconds = 'fast'
    closed = 0

    def close(self):
        Left.closed += 1
        raise ConnectionError('nobody is there')


def test_a_simulator_that_is_of_no_use_is_let_go_of(monkeypatch):
    place = f'{__name__}:Left'
    for act in (lambda: open_drive({'simulator': place}), lambda: registry.frame_seconds(place)):
        before = Left.closed
        with pytest.raises(SimulatorError, match='has frame_seconds fast'):
            act()
        assert Left.closed == before + 1
    monkeypatch.setattr(Left, 'frame_seconds', 0.05)
    assert registry.frame_seconds(place) == 0.05 and Left.closed == before + 1


def test_what_failed_first_is_what_is_told(monkeypatch):
    monkeypatch.setattr(Left, 'frame_seconds', 0.05)
    drive = open_drive({'simulator': f'{__name__}:Left'})
    drive.begin()
    drive.simulator.dot = None
    with pytest.raises(SimulatorError, match='failed in advance: TypeError'):
        drive.advance(STOP, None)
    # who drove it ends with that, and not with what comes of closing it
    drive.close()


def test_time_ends_in_one_line_where_stamps_do():
    drive = open_drive({'simulator': TOY})
    drive.begin()
    drive.stamp = (MAX_SECONDS + 1) * NANOSECONDS - 60_000_000
    assert drive.advance(STOP, None).stamp == (MAX_SECONDS + 1) * NANOSECONDS - 10_000_000
    with pytest.raises(SimulatorError, match=f'simulated {MAX_SECONDS} s'):
        drive.advance(STOP, None)


class Exiting(toy_simulator.Toy):
    def __init__(self, settings):
        raise SystemExit(0)


class Unskippable(toy_simulator.Toy):
    def skip(self, episodes, seed):
        return 1 / 0

    def close(self):
        return 1 / 0


class Unmakeable(toy_simulator.Toy):
    def __init__(self, settings):
        raise KeyError('road')


def test_a_simulator_that_cannot_be_made_is_one_line_with_the_place():
    with pytest.raises(SimulatorError, match=r"failed in __init__: KeyError: 'road' \(test_sim"):
        open_drive({'simulator': f'{__name__}:Unmakeable'})
    with pytest.raises(SimulatorError, match='failed in __init__'):
        make_simulator(f'{__name__}:Unmakeable')
    # an exit would be a node's that has done its work
    with pytest.raises(SimulatorError, match='failed in __init__: SystemExit: 0'):
        make_simulator(f'{__name__}:Exiting')
    drive = Drive(Unskippable(None), SimulationSettings(first_episode=3))
    with pytest.raises(SimulatorError, match='failed in skip: ZeroDivisionError'):
        drive.begin()
    with pytest.raises(SimulatorError, match='failed in close: ZeroDivisionError'):
        Drive(Unskippable(None), SimulationSettings()).close()


@dataclasses.dataclass(frozen=True)
class Undescribed:
    speed: int = 3


@dataclasses.dataclass(frozen=True)
class Unset:
    speed: int = setting('fast', 'a default of another type')


@dataclasses.dataclass(frozen=True)
class Listed:
    gears: list = setting((), 'what no parameter can be')


@dataclasses.dataclass
class Thawed:
    speed: int = setting(3, 'a class that is not frozen')


class Wrong(toy_simulator.Toy):
    Settings = None


@pytest.mark.parametrize('settings_class', [None, int, Undescribed, Unset, Listed, Thawed])
def test_settings_that_cannot_become_parameters_are_one_line(monkeypatch, settings_class):
    monkeypatch.setattr(Wrong, 'Settings', settings_class)
    settings_for.cache_clear()
    for make in (settings_for, make_simulator):
        with pytest.raises(SettingsError, match='Settings is no class of settings') as caught:
            make(f'{__name__}:Wrong')
        assert '\n' not in str(caught.value)


@dataclasses.dataclass(frozen=True)
class Even:
    width: int = setting(48, 'what has to be even', low=2, high=96)

    def __post_init__(self):
        if self.width % 2:
            raise ValueError('width must be even')


class Checked(toy_simulator.Toy):
    Settings = Even


def test_settings_that_check_themselves_are_one_line():
    name = f'{__name__}:Checked'
    for make in (make_simulator, lambda name, values: open_drive({**values, 'simulator': name})):
        assert make(name, {'width': 50})
        with pytest.raises(SimulatorError, match='failed in Settings: ValueError: width must be'):
            make(name, {'width': 51})


def test_a_class_is_found_where_the_folder_was_removed(tmp_path, monkeypatch):
    folder = tmp_path / 'gone'
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    assert find_simulator(TOY) is toy_simulator.Toy


def test_a_module_that_cannot_import_what_it_offers_is_one_line(tmp_path, monkeypatch):
    (tmp_path / 'lazy_offer.py').write_text(
        'def __getattr__(name):\n    import no_such_engine\n')
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SimulatorError, match='cannot give .Car.: ModuleNotFoundError: No module'):
        find_simulator('lazy_offer:Car')


def test_a_profile_whose_name_is_no_text_is_one(tmp_path):
    path = tmp_path / 'p\udcff.yaml'
    path.write_text('simulator: carracing\nsettings: {zoom: false}\n')
    assert find_simulator(str(path)).Settings().zoom is False


# When it goes on. --------------------------------------------------------------------------------

class Stream:
    """What a stepping sends, with a clock of its own; checks what every stream is."""

    def __init__(self, kind=Lockstep, **values):
        self.counts, self.warnings, self.clock = Counter(), [], 0.0
        self.frames, self.ends, self.resent = [], [], 0
        self.settings = settings_for(TOY)(**{'simulator': TOY, **values})
        drive = Drive(toy_simulator.Toy(None), self.settings)
        self.stepping = kind(drive, self, lambda: self.clock)
        self.running = False

    def send_frame(self, frame):
        before = self.frames[-1] if self.frames else None
        step = frame.step
        if before is not None:
            assert frame.stamp > before.stamp
            assert step.episode == before.step.episode + (step.decision == 0)
        assert step.decision == (before.step.decision + 1 if self.running else 0)
        assert self.running == (step.decision > 0)
        self.running = not step.ended
        self.frames.append(frame)
        if frame.episode is not None:
            self.ends.append((int(frame.episode['episode']), step.ended))

    def send_again(self, frame):
        assert frame is self.frames[-1] and self.running
        self.resent += 1

    def send_episode(self, values, stamp):
        assert self.running and values['truncated'] and stamp == self.frames[-1].stamp
        assert values['decisions'] == self.frames[-1].step.decision
        self.running = False
        self.ends.append((int(values['episode']), True))

    def warn(self, text):
        self.warnings.append(text)

    def check(self):
        first = self.settings.first_episode
        assert self.ends == [(first + n // 2, n % 2 == 1) for n in range(len(self.ends))]


ACTS = strategies.one_of(
    strategies.tuples(strategies.just('twist'), strategies.integers(-2, 2)),
    strategies.tuples(strategies.just('pause'), strategies.booleans()),
    strategies.tuples(strategies.just('hold'), strategies.booleans()),
    strategies.tuples(strategies.just('wait'), strategies.floats(0, 5)),
    strategies.tuples(strategies.sampled_from(['step', 'reset', 'beat', 'answer']),
                      strategies.none()))


@settings(max_examples=150, deadline=None)
@given(acts=strategies.lists(ACTS, max_size=80), kind=strategies.sampled_from([
    Lockstep, RealTime]), stamped=strategies.booleans(), repeat=strategies.integers(1, 7),
    on_timeout=strategies.sampled_from(['resend', 'coast', 'hold']),
    episodes=strategies.integers(0, 3), paused=strategies.booleans())
def test_any_order_of_services_and_twists_leaves_a_stream(
        acts, kind, stamped, repeat, on_timeout, episodes, paused):
    stream = Stream(kind, action_repeat=repeat, on_timeout=on_timeout, episodes=episodes,
                    first_episode=2, seed_each_episode=True, start_paused=paused,
                    cmd_vel_stamped=stamped)
    stepping = stream.stepping
    assert stepping.step()[0] is stepping.reset()[0] is False
    stepping.start()
    for act, value in acts:
        sent = len(stream.frames)
        if act == 'twist' and stamped:
            # a stamp some frames away from the newest
            try:
                stepping.take(Command(0.5, 0.5), stream.frames[-1].stamp + value * 50_000_000)
            except MessageError:
                assert kind is Lockstep and value
        elif act in ('twist', 'answer'):
            stepping.take(Command(0.5, -0.5), stream.frames[-1].stamp if stamped else None)
        elif act == 'wait':
            stream.clock += value
        elif act in ('pause', 'hold'):
            getattr(stepping, act)(value)
        else:
            getattr(stepping, act)()
        if stepping.paused and act in ('twist', 'answer', 'wait', 'hold', 'beat'):
            # what a step has allowed, and the first frame of an episode that it ended
            assert len(stream.frames) - sent <= 3
        stream.check()
    if episodes and stepping.finished:
        assert stream.ends[-1] == (2 + episodes - 1, True)
        before = len(stream.frames)
        stepping.beat()
        stepping.take(STOP, stream.frames[-1].stamp if stamped else None)
        assert len(stream.frames) == before and not stepping.reset()[0]


class PlainDriver:
    """Answers every image in order, as fast as it is told; each answer names its image."""

    def __init__(self, **values):
        self.stream = Stream(cmd_vel_stamped=False, answer_timeout=1.0, **values)
        self.images = deque()
        for name in ('send_frame', 'send_again'):
            setattr(self.stream, name, self.hearing(getattr(self.stream, name)))
        self.stream.stepping.start()

    def hearing(self, send):
        return lambda frame: (send(frame), self.images.append(frame))

    def answer(self, seconds):
        """Let time pass, then answer the oldest image that waits."""
        until = self.stream.clock + seconds
        while self.stream.clock < until:
            self.stream.clock = min(until, self.stream.clock + 0.05)
            self.stream.stepping.beat()
        if self.images:
            self.stream.stepping.take(self.answer_to(self.images.popleft()), None)

    @staticmethod
    def answer_to(frame):
        return Command((frame.stamp // 50_000_000 % 997) / 1000, 0.3)

    def wrong(self):
        """Return the number of each episode in which an answer was taken for another."""
        return {frame.step.episode for before, frame in itertools.pairwise(self.stream.frames)
                if frame.step.decision and frame.step.applied is not None
                and frame.step.info['linear'] != self.answer_to(before).linear}


@settings(max_examples=60, deadline=None)
@given(seconds=strategies.lists(strategies.one_of(
    strategies.floats(0.001, 0.3), strategies.floats(0.9, 1.9)), min_size=30, max_size=90),
    resets=strategies.sets(strategies.integers(0, 60), max_size=3))
def test_a_plain_twist_never_counts_for_another_frame_than_the_one_it_answers(seconds, resets):
    driver = PlainDriver()
    for number, taken in enumerate(seconds):
        driver.answer(taken)
        if number in resets:
            driver.stream.stepping.reset()
    driver.stream.check()
    assert not driver.wrong()


def test_a_driver_that_slept_for_long_is_not_a_frame_behind_for_long():
    driver = PlainDriver()
    for taken in (0.1, 0.1, 1.5, 9.0, *[0.1] * 200):
        driver.answer(taken)
    # it slept so long that nobody could know; the end of the episode shows it
    assert driver.wrong() == {0}
    assert driver.stream.frames[-1].step.episode > 2


def test_a_driver_that_lost_an_image_is_waited_for_once():
    stream = Stream(cmd_vel_stamped=False)
    stream.stepping.start()
    stream.clock = 1.1
    stream.stepping.beat()
    assert stream.resent == 1
    # one answer to two images: the first was lost
    stream.stepping.take(STOP, None)
    assert len(stream.frames) == 1
    stream.clock = 3.4
    stream.stepping.beat()
    for count in range(2, 12):
        assert len(stream.frames) == count
        stream.stepping.take(STOP, None)
        stream.stepping.beat()
    assert stream.counts['answer_timeouts'] == 1


def test_the_answers_of_the_services_say_what_is_so():
    stream = Stream(start_paused=True, episodes=2)
    stepping = stream.stepping
    assert stepping.step() == (False, 'not started: nobody drives yet')
    stepping.start()
    assert stepping.step() == (True, '1 step to go as soon as a twist answers')
    assert stepping.step() == (True, '2 steps to go as soon as a twist answers')
    for _ in range(3):
        stepping.take(STOP, stream.frames[-1].stamp)
    assert len(stream.frames) == 3
    assert stepping.step() == (True, 'episode 0, decision 3')
    assert stepping.reset() == (True, 'episode 1')
    assert stepping.reset() == (True, 'all episodes are driven') and stepping.finished
    assert stepping.reset() == stepping.step() == (False, 'all episodes are driven')
    assert stream.ends == [(0, False), (0, True), (1, False), (1, True)]
    assert stepping.pause(False) == 'running'
    assert stepping.step() == (False, 'not paused: call ~/pause with true first')


@pytest.mark.parametrize('on_timeout', ['resend', 'coast', 'hold'])
def test_a_step_while_paused_that_nobody_answers_is_late_as_any_other(on_timeout):
    stream = Stream(on_timeout=on_timeout, start_paused=True, answer_timeout=1.0)
    stepping = stream.stepping
    stepping.start()
    for _ in range(2):
        stream.clock += 5.0
        stepping.beat()
        assert len(stream.frames) == 1 and not stream.resent
    stepping.step()
    # what was paused before it does not count
    stepping.beat()
    assert len(stream.frames) == 1 and not stream.resent
    stream.clock += 1.1
    stepping.beat()
    assert (stream.resent, len(stream.frames)) == ((1, 1) if on_timeout == 'resend' else (0, 2))
    stream.clock += 1.1
    stepping.beat()
    assert (stream.resent, len(stream.frames)) == ((2, 1) if on_timeout == 'resend' else (0, 2))


def test_real_time_lets_go_of_a_stale_twist_and_takes_plain_ones():
    stream = Stream(RealTime, stale_after=0.2)
    stepping = stream.stepping
    stepping.start()
    stepping.take(Command(0.5, 0.25), None)
    for _ in range(8):
        stream.clock += 0.05
        stepping.beat()
    held = [frame.step for frame in stream.frames[1:]]
    assert [step.info['angular'] for step in held[:3]] == [0.25] * 3
    assert [step.info['angular'] for step in held[4:]] == [0.0] * 4
    assert held[0].applied == stream.frames[0].stamp and held[-1].applied is None
    assert stream.counts['stale_twists'] == 1 and 'coasting' in stream.warnings[0]


@pytest.mark.parametrize(('kind', 'values'), [
    (RealTime, {'stale_after': 60.0}), (Lockstep, {'on_timeout': 'hold', 'answer_timeout': 0.1})])
def test_a_twist_that_is_held_does_not_drive_the_next_episode(kind, values):
    stream = Stream(kind, **values)
    stepping = stream.stepping
    stepping.start()
    stepping.take(Command(0.5, 0.25), stream.frames[0].stamp)
    while len({frame.step.episode for frame in stream.frames}) < 3:
        stream.clock += 0.15
        stepping.beat()
    angular = {number: {frame.step.info['angular'] for frame in stream.frames
                        if frame.step.episode == number and frame.step.decision}
               for number in range(2)}
    assert angular == {0: {0.25}, 1: {0.0}}
