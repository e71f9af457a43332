# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`carracing bench demonstrations`: how much driving demonstrated laps save.

A scripted driver stands in for a person with a joystick: it follows the middle of the road,
looking at the true track twelve times a second and steering not quite as it wants. It is recorded
at 50 frames a second as a person is. The recipe `racing`, with continuous actions, which hold what
a joystick says, learns with its laps and without them; with them it explores little, as it need
not find out what a lap is. Both run in one process and are counted in decisions, so that a busy
machine changes nothing; every so many of them the greedy policy drives the same validation tracks.
What is in the output folder is gone on with.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from pathlib import Path
import sys

import numpy as np
import torch

from carracing_dqn.benchmarks.driver import Driver
from carracing_dqn.evaluation.tables import read_table
from carracing_dqn.evaluation.validator import validate_weights
from carracing_dqn.simulation import open_drive
from carracing_dqn.studies.one_process import learn
from carracing_sim_node.controls import command_of
from msgs_bridge.transitions import Transition
from msgs_bridge.twists import STOP
from trainer_node.demonstrations import collect, read_demonstrations, Summary
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.open_run import open_training, read_overrides, run_settings
from trainer_node.run_folder import RunFolder

# beyond the tracks of tests and of the figures in docs/learning.md
DEMONSTRATED_SEED = 900_000
STEERING_NOISE = 0.1
# frames between two looks at the road
REACTION = 4
ACTIONS = 'action_space=continuous'
# with demonstrations
EPSILON = 0.1
FILE = 'demonstrations.safetensors'
PLAIN, SHOWN = 'plain', 'demonstrations'


def scripted_laps(laps: int, seed: int = DEMONSTRATED_SEED) -> Iterator[Transition]:
    """Yield the frames of laps of a scripted driver as transitions of 20 ms."""
    drive = open_drive({'seed': seed, 'seed_each_episode': True})
    random = np.random.default_rng(seed)
    for _ in range(laps):
        frame = drive.begin()
        driver, command = Driver(drive.simulator.env, 'lap'), STOP
        while not frame.step.ended:
            before = frame
            if drive.decision % REACTION == 0:
                steer, gas, brake = map(float, driver.act())
                steer += float(random.normal(0.0, STEERING_NOISE))
                command = command_of(steer, gas, brake).clamped()
            frame = drive.advance(command, before.stamp)
            yield Transition(before.stamp, frame.stamp, before.pixels, frame.pixels, command,
                             frame.step, before.step)


def show(path: Path, settings: Hyperparameters, laps: int) -> Summary:
    """Drive demonstrations into a file, unless they are there; return what they are."""
    if path.is_file():
        return read_demonstrations(path, settings).summary
    path.parent.mkdir(parents=True, exist_ok=True)
    shown = collect(settings, scripted_laps(laps), [f'{laps} scripted laps'])
    shown.write(path)
    return shown.summary


def train(folder: Path, settings: Hyperparameters) -> None:
    """Drive one run to its end, or go on with it."""
    run = RunFolder(folder)
    # one that is to be longer goes on
    if (run.read_record().get('complete') is True
            and load_preset(run.config).run_decisions == settings.run_decisions):
        return
    training = open_training(folder, settings, resume=run.checkpoint.is_file(), device='cpu')
    if not training.decisions:
        while training.pretraining:
            training.pretrain()
        # what was learned before anything was driven
        training.record_validation(validate_weights(
            training.next_weights(validate=True), settings.validation_seeds, settings.simulator))
    learn(training)


def validations(folder: Path) -> list[dict[str, float]]:
    """Return decisions, mean return and share of finished laps of each validation."""
    table, _ = read_table(RunFolder(folder).validation, ())
    names = ('decisions', 'mean', 'completed')
    return [dict(zip(names, map(float, row))) for row in zip(*table.known(*names))]


def decisions_to(rows: list[dict[str, float]], wanted: float) -> float | None:
    """Return after how many decisions a validation first reached a mean; None: none did."""
    return next((row['decisions'] for row in rows if row['mean'] >= wanted), None)


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark from the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='carracing bench demonstrations', description=__doc__.strip().splitlines()[0])
    parser.add_argument('--laps', type=int, default=10, help='demonstrated laps')
    parser.add_argument('--seeds', type=int, nargs='+', default=[42, 43, 44])
    parser.add_argument('--arms', nargs='+', default=[SHOWN, PLAIN], choices=(PLAIN, SHOWN))
    parser.add_argument('--decisions', type=int, default=60_000, help='of each run')
    parser.add_argument('--every', type=int, default=10_000, help='decisions per validation')
    parser.add_argument('--tracks', type=int, default=10, help='of a validation')
    parser.add_argument('--wanted', type=float, nargs='+', default=[400.0, 600.0, 800.0],
                        help='mean returns to be reached')
    parser.add_argument('--set', nargs='*', action='extend', default=[], metavar='NAME=VALUE',
                        help='hyperparameters of both that differ from racing')
    parser.add_argument('--output', type=Path, default=Path('runs/bench-demonstrations'))
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    found = []
    for seed in args.seeds:
        for arm in args.arms:
            folder = args.output / f'{arm}-{seed}'
            # the rate must not depend on how long the run is
            overrides = {**read_overrides([
                f'seed={seed}', f'run_decisions={args.decisions}', 'run_minutes=0',
                'validation_every_minutes=0', f'validation_every_decisions={args.every}',
                f'validation_tracks={args.tracks}', 'learning_rate_schedule=constant',
                'checkpoint_every_minutes=0.5', ACTIONS]), **read_overrides(args.set)}
            if arm == SHOWN:
                # seen from the run folder
                overrides = {
                    'epsilon_start': EPSILON, **overrides, 'demonstrations': f'../{FILE}'}
            settings = run_settings(folder, 'racing', overrides, resume=False)
            summary = show(args.output / FILE, settings, args.laps) if arm == SHOWN else None
            train(folder, settings)
            rows = validations(folder)
            found.append({
                'arm': arm, 'seed': seed, 'validations': rows,
                **({'demonstrations': str(summary)} if summary else {}),
                'decisions_to': {f'{wanted:g}': decisions_to(rows, wanted)
                                 for wanted in args.wanted}})
            sys.stdout.write(json.dumps(found[-1]) + '\n')
            sys.stdout.flush()
    return 0


if __name__ == '__main__':
    sys.exit(main())
