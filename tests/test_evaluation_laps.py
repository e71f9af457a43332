# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Real laps: both simulators, any number of processes, any policy."""
import os
import sys

from carracing_dqn.evaluation import laps as laps_module
from carracing_dqn.evaluation.errors import EvaluationError, PolicyError
from carracing_dqn.evaluation.lap_series import drive_laps
from carracing_dqn.evaluation.laps import drive_lap, lap_of
from carracing_dqn.evaluation.policies import parse_policy, PolicySource
from carracing_dqn.evaluation.progress import summary_rows
from carracing_dqn.evaluation.results import read_json, Results, write_json
from carracing_dqn.evaluation.statistics import statistics_of
from carracing_dqn.evaluation.trajectory import drive_trajectory
from carracing_dqn.evaluation.validator import validate
from carracing_dqn.evaluation.workers import run_jobs
from carracing_dqn.simulation import make_simulator
from evaluation_cases import ByPixels, lap, Steady
import gymnasium
from msgs_bridge.errors import SimulatorError
from msgs_bridge.step import VALIDATION_FIELDS
from msgs_bridge.twists import Command
import numpy as np
import pytest
import toy_simulator

FRAMES = 60


def stock(frames=FRAMES):
    return make_simulator('gymnasium', {'max_episode_frames': frames})


def fast(frames=FRAMES):
    return make_simulator('fast', {'max_episode_frames': frames})


@pytest.mark.parametrize(('action_repeat', 'seed'), [(1, 420), (4, 420), (4, 100_001)])
def test_gymnasium_and_the_fast_simulator_give_the_same_laps(action_repeat, seed):
    policy = ByPixels(action_repeat)
    theirs = drive_lap(stock(), policy, seed)
    ours = drive_lap(fast(), policy, seed)
    assert theirs == ours
    assert ours.frames == FRAMES and ours.seed == seed


def test_a_lap_counts_what_gymnasium_counts():
    env = gymnasium.make('CarRacing-v3', max_episode_steps=60)
    env.reset(seed=7)
    total = 0.0
    for _ in range(60):
        total += env.step(np.array((0.1, 0.3, 0.0)))[1]
    world = env.unwrapped
    driven = drive_lap(stock(60), Steady(), 7)
    assert driven == lap(
        7, round(total, 6), frames=60, tiles_visited=world.tile_visited_count,
        tiles_total=len(world.track))


def test_the_car_that_leaves_the_field_has_left_it():
    policy = Steady((0.0, 1.0, 0.0))
    policy.looks_at_frames = False
    driven = drive_lap(fast(1000), policy, 6)
    assert driven.left_field and not driven.lap_finished
    # -0.1 a frame and 1000/N a tile, but -100 alone for the frame that leaves
    earned = driven.tiles_visited * 1000 / driven.tiles_total - 0.1 * (driven.frames - 1) - 100
    assert driven.episode_return == pytest.approx(earned, abs=1e-5)


def test_standing_still_is_counted_to_the_end():
    driven = drive_lap(fast(200), Steady((0.0, 0.0, 1.0)), 1)
    assert driven.standing_still >= 190


def test_only_frames_that_are_looked_at_are_drawn(monkeypatch):
    simulator = fast(20)
    drawn = []
    draw = simulator.env._renderer.draw
    monkeypatch.setattr(simulator.env._renderer, 'draw', lambda: drawn.append(1) or draw())
    policy = Steady(action_repeat=4)
    drive_lap(simulator, policy, 3)
    # the reset frame and those after 4, 8, 12, 16 and 20
    assert len(drawn) == 6
    assert len(policy.seen) == 20 and all(frame is not None for frame in policy.seen)
    policy.looks_at_frames = False
    drawn.clear()
    drive_lap(simulator, policy, 3)
    assert len(drawn) == 1


@pytest.mark.parametrize('answer', [
    (float('nan'), 0, 0), (0, 2, 0), (0, 0, -0.1), (0, 0.5, 0.5), (1, 2), None, 'left',
    (0, 0, 0, 0), (float('nan'), 0), [0] * 10**6])
def test_an_answer_that_is_no_action_is_refused(answer):
    with pytest.raises(PolicyError, match='the policy answered') as caught:
        drive_lap(fast(5), Steady(answer), 1)
    assert len(str(caught.value)) < 400


def test_a_command_and_the_pedals_it_stands_for_give_the_same_lap():
    pedals = drive_lap(fast(30), Steady((0.2, 0.6, 0.0)), 4)
    assert pedals == drive_lap(fast(30), Steady((0.6, -0.2)), 4)
    assert pedals == drive_lap(fast(30), Steady(Command(0.6, -0.2)), 4)


def test_an_episode_without_laps_counts_by_return_and_length():
    toy = make_simulator('toy_simulator:Toy')
    laps = [drive_lap(toy, Steady((0.0, 1.0)), seed) for seed in range(20)]
    assert laps == list(drive_laps(PolicySource('evaluation_cases:turn_left'), range(20),
                                   simulator='toy_simulator:Toy'))
    assert {lap.lap_finished for lap in laps} == {lap.tiles_total for lap in laps} == {None}
    numbers = statistics_of(laps)
    assert numbers.completed is numbers.tiles is numbers.stopped is numbers.left_field is None
    assert 0 < numbers.frames <= 40 and numbers.maximum > numbers.minimum
    labels = [label for label, _ in summary_rows(numbers)]
    assert labels[-1] == 'frames of an episode' and 'laps finished' not in labels
    values = validate(Steady((0.0, 1.0)), range(20), simulator=toy)
    assert values['completed'] == 0 and values['mean'] == pytest.approx(numbers.mean)
    with pytest.raises(EvaluationError, match='has no track'):
        drive_trajectory(toy, Steady((0.0, 1.0)), 1)


class Endless(toy_simulator.Toy):
    def ends(self):
        return False, False


class Rich(toy_simulator.Toy):
    world = 'its own'

    def advance(self, command, frames=1):
        return super().advance(command, frames)._replace(reward=4e8)


def test_what_no_file_of_laps_could_hold_is_left_out_or_named(tmp_path):
    with pytest.raises(SimulatorError, match='rewards that add up to'):
        drive_lap(Rich(None), Steady((0.0, 0.0)), 3)
    found = lap_of(3, 5.0, 9, {'standing_still': 1e300, 'lap_finished': 1.0,
                               'tiles_visited': float('nan'), 'tiles_total': 9}, 1.0)
    assert found.lap_finished and found.standing_still is found.tiles_visited is None
    write_json(tmp_path / 'r.json', Results({}, 'toy', {3: found}, 1))
    assert read_json(tmp_path / 'r.json').laps == {3: found}
    with pytest.raises(EvaluationError, match='has no track'):
        drive_trajectory(Rich(None), Steady((0.0, 0.0)), 1)


class Crooked(toy_simulator.Toy):
    def pixels(self):
        return super().pixels()[:, :, 0]


def test_an_episode_without_an_end_and_frames_that_are_none_are_named(monkeypatch):
    monkeypatch.setattr(laps_module, 'MAX_FRAMES', 500)
    with pytest.raises(EvaluationError, match='seed 3: no end after 500 frames'):
        drive_lap(Endless(None), Steady((0.0, 1.0)), 3)
    with pytest.raises(SimulatorError, match=r"'Crooked' gives pixels of \(32, 48\)"):
        drive_lap(Crooked(None), Steady((0.0, 1.0)), 3)


def test_processes_do_not_change_the_laps():
    source = PolicySource('random')
    alone = list(drive_laps(source, range(3), simulator='fast'))
    together = list(drive_laps(source, range(3), simulator='fast', processes=2))
    assert sorted(together, key=lambda one: one.seed) == alone
    assert [one.seed for one in alone] == [0, 1, 2]
    assert list(drive_laps(source, [2], simulator='fast')) == alone[2:]


def test_an_unknown_simulator_is_refused():
    with pytest.raises(SimulatorError, match='accepted: carracing, carracing_colours, '):
        list(drive_laps(PolicySource('random'), [1], simulator='slow'))


def test_any_policy_that_acts_can_drive():
    for text in ('coast', 'make_steady', 'Steady'):
        policy = parse_policy(f'evaluation_cases:{text}', '').open()
        assert drive_lap(fast(3), policy, 1).frames == 3


@pytest.mark.parametrize(('text', 'message'), [
    ('modle', 'accepted:'), (':act', 'accepted:'), ('no_such_module:act', 'cannot import'),
    ('evaluation_cases:nobody', "has no 'nobody'"), ('evaluation_cases:NO_POLICY', 'cannot be'),
    ('evaluation_cases:write_run.nothing', 'has no')])
def test_a_policy_that_is_none_is_refused(text, message):
    with pytest.raises(PolicyError, match=message):
        parse_policy(text, '').open()


def _die():
    def work(job):
        if job == 'die':
            os._exit(3)
        sys.exit(3) if job == 'exit' else None
        if job == 'disk':
            raise OSError(5, 'Input/output error')
        raise RuntimeError(f'cannot do {job}')
    return work


def test_a_worker_that_dies_or_fails_ends_the_work():
    for jobs in (['die'], ['die'] * 5):
        with pytest.raises(EvaluationError, match='died'):
            list(run_jobs(_die, jobs, 2))
    # whichever of two is noticed first
    with pytest.raises(EvaluationError, match='died|cannot do th'):
        list(run_jobs(_die, ['die', 'this', 'that'], 2))
    with pytest.raises(EvaluationError, match='failed: SystemExit: 3'):
        list(run_jobs(_die, ['exit'], 1))
    # as it is when it is driven in this process
    with pytest.raises(OSError, match='Input/output error'):
        list(run_jobs(_die, ['disk'], 1))
    with pytest.raises(EvaluationError, match='cannot do this'):
        list(run_jobs(_die, ['this', 'that'], 1))


def test_validation_gives_the_fields_of_the_contract():
    seen = []
    values = validate(PolicySource('random').open(), range(420, 423), version=7,
                      on_lap=seen.append)
    assert list(values) == list(VALIDATION_FIELDS)
    returns = [one.episode_return for one in seen]
    assert values['version'] == 7 and values['episodes'] == 3
    assert values['mean'] == pytest.approx(sum(returns) / 3)
    assert values['std'] == pytest.approx(np.std(returns))
    assert (values['minimum'], values['maximum']) == (min(returns), max(returns))
    assert values['completed'] == 0 and values['seconds'] > 0


def test_validation_stops_when_told():
    values = validate(PolicySource('random').open(), range(9), should_stop=lambda: True)
    assert values['episodes'] == 1
    with pytest.raises(EvaluationError, match='at least one seed'):
        validate(Steady(), [])
