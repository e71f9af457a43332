# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Training, validation and test draw their tracks from spaces that cannot meet."""
from carracing_dqn.evaluation.evaluate_command import TEST_SEED
from carracing_dqn.simulation import open_drive
from carracing_dqn.simulation.settings import SimulationSettings
from hypothesis import given, strategies
from learning_cases import tiny
from msgs_bridge import seeds
from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import from_mapping
import pytest
from trainer_node.hyperparameters import load_preset

WHOLE = strategies.integers(0, 2**31 - 1)


@given(run=WHOLE, car=strategies.integers(0, seeds.MAX_CARS - 1), episode=WHOLE)
def test_no_training_episode_has_a_seed_of_a_validation_or_a_test(run, car, episode):
    seed = seeds.training_seed(run, car)
    assert seed + episode >= seeds.TRAINING > seeds.VALIDATION > seeds.TEST
    # a seed is carried by a float64 and set by a parameter
    assert seed + episode < 2**53
    assert from_mapping(SimulationSettings, {'seed': seed}).seed == seed


def test_cars_and_runs_begin_on_tracks_of_their_own():
    first = {seeds.training_seed(42, car) for car in range(seeds.MAX_CARS)}
    assert len(first) == seeds.MAX_CARS
    runs = sorted(seeds.training_seed(run) for run in range(40, 60))
    assert min(later - sooner for sooner, later in zip(runs, runs[1:])) > 10_000
    with pytest.raises(ValueError, match='car 1024; accepted: 0 to 1023'):
        seeds.training_seed(42, 1024)


def test_the_presets_draw_from_the_spaces():
    racing = load_preset('racing')
    parameters = racing.simulator_parameters()
    assert parameters['seed_each_episode'] and parameters['seed'] >= seeds.TRAINING
    assert seeds.is_validation(racing.validation_seeds[0], len(racing.validation_seeds))
    assert seeds.TEST <= TEST_SEED < seeds.VALIDATION - 100_000
    # the document's own numbers: a stream, and tracks of the space of tests
    report = load_preset('report')
    assert not report.simulator_parameters()['seed_each_episode']
    assert (report.simulator_parameters()['seed'], report.validation_seed) == (42, 420)


@pytest.mark.parametrize('first', [420, 2**20 - 1, 2**21 - 4, 2**21])
def test_validation_seeds_of_another_space_are_refused(first):
    with pytest.raises(SettingsError, match=f'validation_seed {first} .* must lie from 1048576'):
        tiny(seed_each_episode=True, validation_seed=first)
    assert tiny(validation_seed=first).validation_seed == first


def tracks(count, **settings):
    """Return the first frames of some episodes: what the track looks like from its start."""
    drive = open_drive(settings)
    return [drive.begin().pixels.tobytes() for _ in range(count)]


def test_the_reports_stream_of_tracks_has_none_of_its_validation():
    stream = tracks(12, **load_preset('report').simulator_parameters())
    validation = tracks(5, seed=420, seed_each_episode=True)
    assert len(set(stream)) == 12
    assert not set(stream) & set(validation)
