# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations: made from frames, kept for good, learned first, and gone on with exactly."""
from collections import Counter
import dataclasses
import json
import math

from bag_cases import record_drive
from dqn_policy_node.action_space import ACTION_SPACES, action_space
from graph_probe import carracing
from learning_cases import Clock, drive, make_step, make_transition, rows, stream, tiny
from msgs_bridge.errors import SettingsError
from msgs_bridge.twists import Command
import numpy as np
import pytest
import torch
from trainer_node.action_values import action_values
from trainer_node.checkpoint_file import read_checkpoint, write_checkpoint
from trainer_node.demonstrations import (
    as_decisions, collect, FORMAT, nearest, read_demonstrations,
)
from trainer_node.driver import Driver
from trainer_node.errors import LearningError, RunError
from trainer_node.learner import LEARNERS, LearnerEntry, make_learner
from trainer_node.learning import Learning
from trainer_node.replay_buffer import Batch
from trainer_node.training import Training
import yaml

FRAME = 20_000_000
GAS = Command(1.0, 0.0)
QUANTILES = {'learner': 'qr_dqn', 'quantiles': 8}


def frames(count, *, command=GAS, start=0, end=True):
    """Return transitions of 20 ms, the last of which ends the episode."""
    return [make_transition(
        stamp=start + FRAME * number, next_stamp=start + FRAME * (number + 1), command=command,
        step=make_step(reward=1.0, decision=number + 1, episode_return=number + 1.0,
                       terminated=float(end and number == count - 1)))
        for number in range(count)]


def test_frames_become_decisions():
    given = frames(10)
    given[1] = dataclasses.replace(given[1], command=Command(0.0, 0.4))
    decisions = list(as_decisions(given, 0.08))
    assert [one.step.reward for one in decisions] == [4.0, 4.0, 2.0]
    assert decisions[0].command == (pytest.approx(0.75), pytest.approx(0.1))
    assert [one.next_stamp for one in decisions] == [4 * FRAME, 8 * FRAME, 10 * FRAME]
    assert decisions[-1].step.ended and not decisions[0].step.ended
    # what a gap cuts off is no decision
    torn = given[:2] + given[5:]
    assert [one.stamp for one in as_decisions(torn, 0.08)] == [5 * FRAME, 9 * FRAME]
    # those that are decisions already stay as they are
    same = list(as_decisions(given, 0.02))
    assert len(same) == len(given) and all(
        np.array_equal(vars(one)[name], vars(other)[name])
        for one, other in zip(same, given) for name in vars(other))
    # further apart than decisions, or of no number that is as long as one
    for seconds in (0.01, 0.03, 0.035):
        with pytest.raises(LearningError, match=f'0.02 s apart.*{seconds} s'):
            list(as_decisions(given, seconds))
    # stamps of a real camera are never even, and one frame comes late
    uneven = [dataclasses.replace(
        one, stamp=one.stamp + 10**6 * (number % 3) + (number > 4) * 2 * FRAME,
        next_stamp=one.next_stamp + 10**6 * ((number + 1) % 3) + (number > 3) * 2 * FRAME)
        for number, one in enumerate(given)]
    counts = Counter()
    assert [round((one.next_stamp - one.stamp) / 10**6) for one in as_decisions(
        uneven, 0.04, counts)] == [42, 39, 39, 39, 21]
    assert counts == {'uneven': 1}


@pytest.mark.parametrize('name', ACTION_SPACES)
def test_the_nearest_action_is_the_nearest_and_of_its_own_it_is_itself(name):
    space = ACTION_SPACES[name]
    random = np.random.default_rng(3)
    for _ in range(50):
        own = space.explore(random)
        command = space.decode(own)
        assert space.decode(nearest(space, command)[0]) == pytest.approx(command)
        wanted = Command(*random.uniform(-1, 1, 2))
        _, distance = nearest(space, wanted)
        others = [space.decode(space.explore(random)) for _ in range(50)]
        assert all(distance <= max(abs(a - b) for a, b in zip(wanted, other)) + 1e-6
                   for other in others)


def test_what_no_action_means_is_told():
    given = frames(4, command=Command(0.9, 0.05)) + frames(4, start=10 * FRAME)
    shown = collect(tiny(action_space='grid9'), given, ['lap'])
    summary = shown.summary
    assert (summary.decisions, summary.foreign, summary.episodes) == (2, 1, 2)
    assert summary.distance_worst == pytest.approx(0.1)
    assert summary.distance_mean == pytest.approx(0.05)
    assert '2 decisions of 2 episodes' in str(summary) and '0.100 at worst' in str(summary)
    assert collect(
        tiny(action_space='continuous'), given, ['lap']).summary.distance_worst < 1e-6
    with pytest.raises(LearningError, match='hold no transition'):
        collect(tiny(), [], [])


def test_the_file_is_read_as_it_was_and_for_no_other_settings(tmp_path):
    path, settings = tmp_path / 'shown', tiny()
    shown = collect(settings, stream(40), ['lap'])
    shown.write(path)
    again = read_demonstrations(path, settings)
    assert again.summary == shown.summary and again.sha256 == shown.sha256
    first, second = (one.replay.sample(64, np.random.default_rng(1)) for one in (shown, again))
    assert all(np.array_equal(one, two) for one, two in zip(first, second))
    for changes, told in (
            ({'action_space': 'grid9'}, 'action_space'), ({'shrink': 4}, 'preprocessing'),
            ({'reward_scale': 0.5}, 'reward_scale')):
        with pytest.raises(RunError, match=f'made for another {told}'):
            read_demonstrations(path, tiny(**changes))
    with pytest.raises(RunError, match='no such demonstrations'):
        read_demonstrations(tmp_path / 'nowhere', settings)
    arrays, state = read_checkpoint(path, FORMAT)
    for name, value in (('actions', np.full_like(arrays['actions'], 200)),
                        ('rewards', np.full_like(arrays['rewards'], np.inf)),
                        ('observations', arrays['observations'][:, :1])):
        write_checkpoint(path, {**arrays, name: value}, state, FORMAT)
        with pytest.raises(RunError, match='damaged demonstrations'):
            read_demonstrations(path, settings)
    for odd in ({'written': 10**12}, {'written': math.inf},
                {'summary': {**state['summary'], 'mean_return': 10**400}}):
        write_checkpoint(path, arrays, {**state, **odd}, FORMAT)
        with pytest.raises(RunError, match='damaged demonstrations|mean_return is'):
            read_demonstrations(path, settings)


def test_an_episode_whose_last_decision_is_left_out_was_driven_to_its_end():
    odd = [dataclasses.replace(one, next_frame=one.next_frame[:50]) if one.step.ended else one
           for one in stream(26)]
    summary = collect(tiny(), odd, ['lap']).summary
    assert (summary.episodes, summary.decisions, summary.left_out) == (2, 24, 2)


def test_a_share_of_every_batch_is_demonstrated_and_never_overwritten():
    settings = tiny(demonstration_share=0.25, demonstration_updates=0, replay_capacity=100)
    bright = np.full((96, 96, 3), 250, np.uint8)
    shown = collect(settings, [
        dataclasses.replace(one, frame=bright, next_frame=bright) for one in frames(24)], [])
    learning = Learning(settings, 'cpu', shown)
    for transition in stream(300):
        learning.insert(transition)
    batch = learning._sample(False)
    assert batch.demonstrated == 2 and len(batch.rewards) == settings.batch_size
    assert (batch.observations[:2] == 250).all() and (batch.observations[2:] < 250).any()
    assert len(batch.observations) == len(batch.next_observations) == settings.batch_size
    assert batch.observations.transpose(0, 2, 3, 1).flags.c_contiguous
    assert (learning._sample(True).observations == 250).all()


def values_of(learner, batch):
    network = learner.online
    with torch.no_grad():
        return network(network.prepare(torch.from_numpy(batch.observations))).numpy()


def random_batch(space, demonstrated, size=6):
    random = np.random.default_rng(0)
    return Batch(random.integers(0, 256, (size, 2, 12, 12), np.uint8),
                 np.array([space.explore(random) for _ in range(size)], space.dtype),
                 np.zeros(size, np.float32), random.integers(0, 256, (size, 2, 12, 12), np.uint8),
                 np.zeros(size, np.float32), demonstrated)


@pytest.mark.parametrize('learner', [{}, QUANTILES], ids=['dqn', 'qr_dqn'])
def test_the_margin_loss_by_hand(learner):
    def loss(demonstrated, **changes):
        torch.manual_seed(0)
        made = make_learner(tiny(demonstration_margin=0.5, **learner, **changes), 'cpu')
        batch = random_batch(action_space('seed5'), demonstrated)
        values = values_of(made, batch)
        return made.update(batch, 1e-3)['loss'], values, batch.actions

    plain, values, actions = loss(0)
    expected = 0.0
    for row, action in zip(values[:4], actions[:4]):
        raised = row + 0.5
        raised[action] -= 0.5
        expected += raised.max() - row[action]
    assert expected > 0
    assert loss(4)[0] - plain == pytest.approx(expected / 6, rel=1e-4)
    assert loss(4, demonstration_weight=3.0)[0] - plain == pytest.approx(expected / 2, rel=1e-4)
    assert loss(4, demonstration_weight=0.0)[0] == plain


@pytest.mark.parametrize('name', ['continuous', 'hybrid', 'seed5+any'])
def test_along_axes_the_margin_grows_up_to_the_next_node(name):
    space, random = action_space(name), np.random.default_rng(1)
    actions = np.array([space.explore(random) for _ in range(40)], np.float32)
    apart = action_values(space).apart(torch.from_numpy(actions), len(space)).numpy()
    for row, action in zip(apart, actions):
        expected = np.ones(len(space))
        for axis, place in zip(space.layout[space.mode(action)], action):
            for output in range(axis.start, axis.stop):
                expected[output] = min(abs(output - place), 1)
        assert row == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize('changes', [
    {}, QUANTILES, {'action_space': 'continuous'}, {'action_space': 'seed5+any', **QUANTILES}],
    ids=['dqn', 'qr_dqn', 'continuous', 'hybrid quantiles'])
def test_what_is_shown_is_what_is_best_before_anything_was_driven(changes):
    settings = tiny(demonstration_updates=300, learning_rate=3e-3, hidden=32, **changes)
    space = settings.model_description().action_space
    # what to do is to be seen in the picture, and earns nothing
    given, pictures = [], []
    for number, command in enumerate((Command(1.0, 0.0), Command(0.0, 1.0), Command(0.0, -1.0))):
        picture = np.zeros((96, 96, 3), np.uint8)
        picture[:, 32 * number:32 * (number + 1)] = 255
        pictures.append((picture, command))
        for each in range(10):
            given.append(make_transition(
                stamp=(100 * number + each) * 4 * FRAME,
                next_stamp=(100 * number + each + 1) * 4 * FRAME,
                frame=picture, next_frame=picture, command=command))
    learning = Learning(settings, 'cpu', collect(settings, given, []))
    while learning.pretraining:
        learning.update(0.0)
    assert learning.learner.updates == 300 and learning.limiter.samples == 0
    for picture, command in pictures:
        seen = learning._preprocess(picture)
        stack = torch.from_numpy(np.stack([seen, seen])[None])
        network = learning.learner.online
        with torch.no_grad():
            outputs = network(network.prepare(stack))[0].numpy()
        assert space.decode(space.greedy(outputs)) == command


def create(folder, **changes):
    settings = tiny(demonstrations='shown', demonstration_updates=35, dropout=0.2, flips=True,
                    convolutions='4@4/4 8@2/1', n_steps=3, **changes)
    folder.mkdir()
    collect(settings, stream(60, seed=9), ['lap']).write(folder / 'shown')
    return Training.create(settings, folder, device='cpu', clock=Clock())


def driver_of(training, log):
    return Driver(training, lambda data: log.append(training.version))


@pytest.mark.parametrize('changes', [{}, QUANTILES, {'action_space': 'seed5+any'}],
                         ids=['dqn', 'qr_dqn', 'hybrid'])
def test_a_run_with_demonstrations_goes_on_as_if_nothing_had_happened(tmp_path, changes):
    transitions = list(stream(120))

    def first_turns(training, turns):
        driver = driver_of(training, [])
        for _ in range(turns):
            driver.turn()
        return driver

    whole = create(tmp_path / 'whole', **changes)
    assert whole.pretraining
    assert not first_turns(whole, 4).pretraining and whole.learning.learner.updates == 35
    drive(whole, transitions)
    whole.finish()
    parts = create(tmp_path / 'parts', **changes)
    # once in the middle of what comes before driving, once later on
    assert first_turns(parts, 2).pretraining
    parts.save()
    parts = Training.resume(tmp_path / 'parts', device='cpu', clock=Clock())
    first_turns(parts, 2)
    drive(parts, transitions[:70])
    parts.save()
    drive(parts, transitions[70:90])
    parts = Training.resume(tmp_path / 'parts', device='cpu', clock=Clock())
    drive(parts, transitions[70:])
    parts.finish()

    first, second = (read_checkpoint(tmp_path / name / 'checkpoint' / 'checkpoint.safetensors')
                     for name in ('whole', 'parts'))
    for name, array in first[0].items():
        assert np.array_equal(array, second[0][name]), name
    assert first[1]['learning']['limiter'] == second[1]['learning']['limiter']
    record = json.loads((tmp_path / 'parts' / 'run.json').read_text())
    assert record['demonstrations']['decisions'] == 60
    assert record['demonstrations']['sources'] == ['lap']
    assert rows(tmp_path / 'parts' / 'episodes.csv')


def test_a_run_does_not_go_on_with_other_demonstrations(tmp_path):
    training = create(tmp_path / 'run')
    training.finish()
    with pytest.raises(RunError, match='demonstrations is , not shown'):
        Training.resume(
            tmp_path / 'run', dataclasses.replace(training.settings, demonstrations=''),
            device='cpu')
    collect(training.settings, stream(60, seed=8), ['other']).write(tmp_path / 'run' / 'shown')
    with pytest.raises(RunError, match='others than the run began with'):
        Training.resume(tmp_path / 'run', device='cpu')
    (tmp_path / 'run' / 'shown').unlink()
    with pytest.raises(RunError, match='shown: no such demonstrations'):
        Training.resume(tmp_path / 'run', device='cpu')


def test_a_learner_without_a_margin_is_refused(monkeypatch):
    monkeypatch.setitem(LEARNERS, 'plain', LearnerEntry('nowhere:Learner'))
    with pytest.raises(SettingsError, match="'plain' knows no margin.*dqn, qr_dqn"):
        tiny(learner='plain', demonstrations='x')
    tiny(learner='plain', demonstrations='x', demonstration_weight=0.0)


PRESET = {
    'convolutions': '8@8/4 8@4/2', 'hidden': 16, 'shrink': 2, 'action_repeat': 4,
    'action_space': 'grid9', 'learning_starts': 20, 'replay_capacity': 5000, 'weights_every': 20,
    'validation_every_episodes': 0, 'run_episodes': 0, 'run_decisions': 150,
    'demonstration_updates': 30,
}


def test_a_run_begins_with_bags_that_anybody_drove_and_says_how_well_they_fit(tmp_path):
    bag = record_drive(tmp_path / 'lap', episodes=2, decisions=120)
    (tmp_path / 'tiny.yaml').write_text(yaml.safe_dump(PRESET))
    run = tmp_path / 'run'
    words = ('train', '--preset', str(tmp_path / 'tiny.yaml'), '--run', str(run))
    done = carracing(*words, '--demonstrations', str(bag), timeout=180)
    assert done.returncode == 0, done.stderr
    assert 'demonstrations: 60 decisions of 2 episodes' in done.stdout
    record = json.loads((run / 'run.json').read_text())
    shown = record['demonstrations']
    assert shown['sources'] == ['lap'] and shown['decisions'] == 60
    assert 0 < shown['distance_mean'] < shown['distance_worst'] < 0.5 and shown['foreign'] > 0
    state = read_checkpoint(run / 'checkpoint' / 'checkpoint.safetensors')[1]['learning']
    # 130 transitions with 8 samples each in batches of 32, after those before driving
    assert state['updates'] == 30 + (150 - 20) // 4 and state['decisions'] == 150
    for more, told in ((('--from-bag', str(bag)), 'drives nothing'),
                       (('--resume', str(run)), 'for a new run')):
        done = carracing('train', '--demonstrations', str(bag), *more)
        assert done.returncode == 2 and told in done.stderr and done.stderr.count('\n') == 1
    done = carracing(*words[:-1], str(tmp_path / 'other'), '--demonstrations', 'nowhere')
    assert done.returncode == 2 and 'nowhere' in done.stderr
    assert not (tmp_path / 'other').exists()
