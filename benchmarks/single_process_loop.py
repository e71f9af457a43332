# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The learning loop in one process, without ROS: the baseline that the graph is measured against.

It does the same work with the same classes: environment, policy, training. Also the quickest way
to try a recipe:

    python -m benchmarks.single_process_loop --preset racing --run runs/try --minutes 20
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import sys
import time

import numpy as np

from carracing_sim_node import make_env
from dqn_policy_node.policy import Policy
from dqn_policy_node.weights_message import decode_weights
from msgs_bridge.settings import parse_text
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.transitions import Transition
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.training import Training

FRAME_NANOSECONDS = NANOSECONDS // 50


class Simulator:
    """The environment with the facts that the `step` topic carries."""

    def __init__(self, *, action_repeat: int, early_end_frames: int = 0) -> None:
        """Make the environment."""
        self._env = make_env(action_repeat=action_repeat, early_end_frames=early_end_frames)
        self.stamp = 0
        self._episode = -1

    def reset(self, seed: int | None = None) -> tuple[np.ndarray, dict[str, float]]:
        """Start an episode; return its frame, uint8 (96, 96, 3), and facts."""
        frame, _ = self._env.reset(seed=seed)
        self.stamp += NANOSECONDS
        self._episode += 1
        self._decision, self._return, self._frames = 0, 0.0, 0
        return frame, self._facts(0.0, False, False, False)

    def step(self, action: tuple[float, float, float]) -> tuple[np.ndarray, dict[str, float]]:
        """Hold an action; return the frame after it and its facts."""
        frame, reward, terminated, truncated, info = self._env.step(action)
        self._decision += 1
        self._return += reward
        left_field = terminated and not info['lap_finished']
        facts = self._facts(reward, terminated, truncated, left_field)
        self.stamp += int(facts['frames']) * FRAME_NANOSECONDS
        return frame, facts

    def _facts(
        self, reward: float, terminated: bool, truncated: bool, left_field: bool,
    ) -> dict[str, float]:
        facts = self._env.facts()
        frames = facts.frames - self._frames
        self._frames = facts.frames
        return {
            'reward': reward, 'terminated': terminated, 'truncated': truncated,
            'lap_finished': facts.lap_finished, 'left_field': left_field,
            'ended_early': facts.ended_early, 'episode': self._episode,
            'decision': self._decision, 'step': facts.frames, 'episode_return': self._return,
            'tiles_visited': facts.tiles_visited, 'tiles_total': facts.tiles_total,
            'tiles_missed': facts.tiles_missed, 'wheels_off_road': facts.wheels_off_road,
            'speed': facts.speed, 'standing_still': facts.standing_still, 'frames': frames,
        }


def drive(policy: Policy, tracks: range) -> dict[str, float]:
    """Drive greedily over seeded tracks of the full environment; return `VALIDATION_FIELDS`."""
    started = time.monotonic()
    simulator = Simulator(action_repeat=policy.action_repeat)
    epsilon, policy.epsilon = policy.epsilon, 0.0
    returns, finished = [], []
    for seed in tracks:
        frame, facts = simulator.reset(seed)
        policy.reset()
        while not (facts['terminated'] or facts['truncated']):
            frame, facts = simulator.step(policy.decide(frame).action)
        returns.append(facts['episode_return'])
        finished.append(facts['lap_finished'])
    policy.epsilon = epsilon
    policy.reset()
    return {
        'version': policy.version, 'episodes': len(returns), 'mean': float(np.mean(returns)),
        'std': float(np.std(returns)), 'minimum': min(returns), 'maximum': max(returns),
        'completed': float(np.mean(finished)), 'seconds': time.monotonic() - started}


def learn(
    training: Training, *, minutes: float, report: Callable[[dict[str, float]], None],
    validate: bool = True,
) -> None:
    """
    Drive and learn until the run is complete or the time is over.

    Args:
        training: the run.
        minutes: most wall-clock minutes for this call.
        report: takes the figures of the moment every ten seconds and at validations.
        validate: whether to drive validations in this process when they are due.
    """
    settings = training.settings
    simulator = Simulator(
        action_repeat=settings.action_repeat, early_end_frames=settings.early_end_frames)
    policy = Policy(training.description, seed=settings.seed)
    policy.action_repeat = settings.action_repeat
    started = reported = time.monotonic()
    ended = True
    seed: int | None = settings.seed
    while not training.complete and time.monotonic() - started < minutes * 60:
        if training.weights_due():
            update = decode_weights(training.weights_message(), training.description)
            policy.swap_weights(update)
            if update.validate and validate:
                judge = Policy(training.description)
                judge.swap_weights(update)
                first = settings.validation_seed
                training.record_validation(
                    drive(judge, range(first, first + settings.validation_tracks)))
                report(training.status())
        if ended:
            frame, facts = simulator.reset(seed)
            seed = None
            policy.reset()
        stamp, previous, before = simulator.stamp, facts, frame
        action = policy.decide(frame).action
        frame, facts = simulator.step(action)
        training.add(Transition(
            stamp, simulator.stamp, before, frame, action, facts, previous))
        ended = bool(facts['terminated'] or facts['truncated'])
        if training.checkpoint_due():
            training.save()
        if time.monotonic() - reported > 10:
            reported = time.monotonic()
            report(training.status())


def main(argv: list[str] | None = None) -> int:
    """Run the loop from the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--preset', default='racing', help='preset name or file')
    parser.add_argument('--run', type=Path, required=True, help='run folder')
    parser.add_argument('--minutes', type=float, default=60.0, help='wall-clock limit')
    parser.add_argument('--resume', action='store_true', help='go on from the checkpoint')
    parser.add_argument('--set', nargs='*', action='extend', default=[], metavar='NAME=VALUE',
                        help='hyperparameters that differ from the preset')
    args = parser.parse_args(argv)
    overrides = {}
    for pair in args.set:
        name, _, text = pair.partition('=')
        overrides[name] = parse_text(Hyperparameters, name, text)

    def report(status: dict[str, float]) -> None:
        sys.stdout.write(json.dumps({
            name: float(f'{value:.5g}') for name, value in status.items()}) + '\n')
        sys.stdout.flush()

    if args.resume:
        training = Training.resume(args.run)
    else:
        training = Training.create(load_preset(args.preset, overrides), args.run)
    try:
        learn(training, minutes=args.minutes, report=report)
    finally:
        training.finish()
    return 0


if __name__ == '__main__':
    sys.exit(main())
