# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Laps, runs and policies that the tests of the evaluation share."""
import json
from pathlib import Path

from carracing_dqn.evaluation.laps import Lap
from carracing_dqn.evaluation.results import Results, write_json
import numpy as np

EPISODES = (
    'episode,train_reward,validation_reward,epsilon,learning_rate,frames,decisions,lap_finished,'
    'ended_early,tiles_visited,tiles_total,standing_still,loss,q_mean,td_error,updates,'
    'replay_size,replay_ratio,weights_version,wall_seconds')
VALIDATION = (
    'version,episode,decisions,updates,wall_seconds,episodes,mean,std,minimum,maximum,completed,'
    'seconds')
UPDATES = (
    'updates,decisions,loss,td_error,q_mean,grad_norm,learning_rate,epsilon,wall_seconds,'
    'updates_per_second')


def lap(seed: int, episode_return: float, **values) -> Lap:
    """Return a lap of 1000 frames that was not finished, unless said otherwise."""
    return Lap(**{
        'seed': seed, 'episode_return': float(episode_return), 'frames': 1000,
        'tiles_visited': 270, 'tiles_total': 300, 'lap_finished': False, 'left_field': False,
        'standing_still': 0, 'seconds': 1.0, **values})


def results(returns, *, kind: str = 'model', **values) -> Results:
    """Return results of laps of some returns."""
    laps = {seed: lap(seed, value, **values) for seed, value in enumerate(returns, 100_000)}
    return Results({'kind': kind, 'name': kind}, 'gymnasium', laps, len(laps), 1.0, {})


def write_run(
    folder: Path, rewards, *, validations=((1, 500, 20),), test=None, dummy=None,
) -> Path:
    """Write a run folder: rewards by episode, (episode, mean, std), returns of test laps."""
    folder.mkdir(parents=True)
    rows = [f'{n},{reward},,{1 - n / len(rewards)},0.0001,1000,{n * 250},0,0,9,300,0,0.1,0.2,0.3,'
            f'{n * 60},{n * 250},8,1,{n * 6}' for n, reward in enumerate(rewards)]
    (folder / 'episodes.csv').write_text('\n'.join([EPISODES, *rows]) + '\n')
    rows = [f'1,{episode},9,9,{episode * 6},5,{mean},{std},0,900,0.4,3'
            for episode, mean, std in validations]
    (folder / 'validation.csv').write_text('\n'.join([VALIDATION, *rows]) + '\n')
    rows = [f'{n},{4 * n},{1 / n},0.1,{n / 100},1,0.0001,0.5,{n},30' for n in (200, 400, 600)]
    (folder / 'updates.csv').write_text('\n'.join([UPDATES, *rows]) + '\n')
    (folder / 'config.yaml').write_text('gamma: 0.97\ntarget_every: 10\ntarget_update: episodes\n')
    (folder / 'run.json').write_text(json.dumps({'complete': True, 'wall_seconds': 1800}))
    if test is not None:
        write_json(folder / 'evaluation.json', results(test))
    if dummy is not None:
        write_json(folder / 'dummy.json', results(dummy, kind='random'))
    return folder


class Steady:
    """Always the same action; remembers the frames it was shown."""

    def __init__(self, action=(0.1, 0.3, 0.0), action_repeat: int = 1) -> None:
        """Hold an action; `action_repeat` is what it says of itself."""
        self.action = action
        self.action_repeat = action_repeat
        self.seen: list[np.ndarray] = []

    def reset(self, seed=None) -> None:
        """Forget the frames."""
        self.seen = []

    def act(self, frame):
        """Return the action."""
        if len(self.seen) < 10_000:
            self.seen.append(frame)
        return self.action


class ByPixels:
    """Acts by what it sees, every `action_repeat` frames: other pixels give other laps."""

    def __init__(self, action_repeat: int = 1) -> None:
        """Decide every some frames."""
        self.action_repeat = action_repeat

    def reset(self, seed=None) -> None:
        """Start to count."""
        self.calls = 0

    def act(self, frame):
        """Return an action made from all the bytes of the frame."""
        if self.calls % self.action_repeat == 0:
            value = int(frame.astype(np.int64).sum() + 7 * frame[::3, ::5].sum()) % 1000 / 1000
            self.held = (2 * value - 1, 0.4 * value, 0.0)
        self.calls += 1
        return self.held


def coast(frame):
    """Be a policy that is a plain function."""
    return 0.0, 0.0, 0.0


def make_steady():
    """Be a factory of policies."""
    return Steady()


def turn_left(frame):
    """Be a policy for any simulator."""
    return 0.0, 1.0


def fail(frame):
    """Be a policy with a fault."""
    raise RuntimeError('a fault of its own')


def leave(frame):
    """Be a policy that ends its process."""
    raise SystemExit(0)


class Unmade:
    """A policy that cannot be made."""

    def __init__(self) -> None:
        """Fail."""
        raise OSError('no hands')


def not_finite(frame):
    """Be a policy that has lost its mind."""
    return float('nan'), 0.0, 0.0


NO_POLICY = 5
