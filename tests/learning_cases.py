# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A tiny agent, streams of transitions and runs of them for the tests of learning."""
import csv
import re

from dqn_policy_node.action_space import DUMMY_SPACE
from dqn_policy_node.weights_message import decode_weights
from msgs_bridge.step import read_step
from msgs_bridge.transitions import Transition
import numpy as np
from trainer_node.hyperparameters import Hyperparameters
from trainer_node.training import Training

TINY = {
    'convolutions': '4@4/4', 'hidden': 8, 'shrink': 8, 'frame_stack': 2, 'action_repeat': 4,
    'replay_capacity': 200, 'learning_starts': 20, 'batch_size': 8, 'weights_every': 10,
    'validation_every_episodes': 3, 'run_episodes': 0,
}
SESSION = rb'session[^0-9a-f]{1,9}[0-9a-f]{32}'
COMMANDS = DUMMY_SPACE.commands


def tiny(**changes):
    return Hyperparameters(**{**TINY, **changes})


def make_step(**changes):
    return read_step({
        'reward': 0.0, 'terminated': 0.0, 'truncated': 0.0, 'lap_finished': 0.0,
        'left_field': 0.0, 'ended_early': 0.0, 'came_round': 0.0, 'episode': 0.0, 'decision': 0.0,
        'step': 0.0, 'episode_return': 0.0, 'tiles_visited': 0.0, 'tiles_total': 300.0,
        'tiles_missed': 0.0, 'lap_position': 0.0, 'wheels_off_road': 0.0, 'speed': 0.0,
        'standing_still': 0.0, 'frames': 4.0, 'seed': -1.0, 'applied_sec': 0.0,
        'applied_nanosec': 0.0, **changes})


def make_transition(**changes):
    frame = np.zeros((96, 96, 3), np.uint8)
    return Transition(**{
        'stamp': 0, 'next_stamp': 80_000_000, 'frame': frame, 'next_frame': frame,
        'command': COMMANDS[0], 'step': make_step(), 'previous': make_step(), **changes})


def stream(count, *, seed=0, episode_length=13, terminated_share=0.5):
    """Yield `count` transitions of random frames in episodes that end both ways."""
    random = np.random.default_rng(seed)
    stamp, episode, decision, total = 0, 0, 0, 0.0
    frame = random.integers(0, 256, (96, 96, 3), np.uint8)
    previous = make_step()
    for _ in range(count):
        next_frame = random.integers(0, 256, (96, 96, 3), np.uint8)
        decision += 1
        reward = float(random.normal())
        total += reward
        ended = decision == episode_length
        terminated = float(ended and random.random() < terminated_share)
        step = make_step(
            reward=reward, terminated=terminated, truncated=float(ended) - terminated,
            lap_finished=terminated, episode=episode, decision=decision, step=4 * decision,
            episode_return=total, tiles_visited=float(decision), speed=20.0)
        command = COMMANDS[random.integers(len(COMMANDS))]
        next_stamp = stamp + 80_000_000
        yield Transition(stamp, next_stamp, frame, next_frame, command, step, previous)
        stamp, frame, previous = next_stamp, next_frame, step
        if ended:
            stamp += 1_000_000_000
            episode, decision, total = episode + 1, 0, 0.0
            frame = random.integers(0, 256, (96, 96, 3), np.uint8)
            previous = make_step(episode=episode)


class Clock:
    """Seconds that go forward by one with every look."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        self.seconds += 1.0
        return self.seconds


def streams(count, names):
    """Yield `count` transitions of several sources, mixed at random, each with its name."""
    random = np.random.default_rng(7)
    sources = [stream(count, seed=number) for number in range(len(names))]
    for _ in range(count):
        number = random.integers(len(names))
        yield next(sources[number]), names[number]


def drive(training, transitions, log=None):
    """Do what a driver does with each transition; validations are answered at once."""
    for transition in transitions:
        training.add(*(transition if isinstance(transition, tuple) else (transition,)))
        if training.weights_due():
            data = training.next_weights()
            if log is not None:
                # which start of a trainer it was is the one thing that is never the same
                log.append(re.sub(SESSION, b'', data))
            update = decode_weights(data, training.description)
            if update.validate:
                training.record_validation(validation(update.version))


def validation(version, **changes):
    return {'version': version, 'episodes': 5, 'mean': 10.0 * version, 'std': 1.0, 'minimum': 0,
            'maximum': 20, 'completed': 0.2, 'seconds': 3, **changes}


def rows(path):
    with open(path, newline='') as file:
        return list(csv.DictReader(file))


def create(folder, **changes):
    return Training.create(tiny(**changes), folder, device='cpu', clock=Clock())
