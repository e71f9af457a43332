# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether a policy of CarRacing laps the tracks of pyRacerz, which it has never seen.

Every track in both directions, from seeded starts, beside random actions and the game's robot.
A start counts if a whole lap is finished by the game's own rules within 25 simulated seconds; it
is given up before that once the car has stood for five.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import itertools
import json
from pathlib import Path
import statistics
import sys
from typing import Any

from PIL import Image
from carracing_dqn.evaluation.laps import checked_command, looks_every
from carracing_dqn.evaluation.policies import parse_policy
from carracing_dqn.simulation import make_simulator
from dqn_policy_node.shipped_models import RANDOM
from msgs_bridge.twists import STOP
import numpy as np

TRACKS = ('bio', 'city', 'desert', 'formula', 'http', 'kart', 'wave')
DIRECTIONS = ('normal', 'reverse')
# who drives, on which profile, with which further settings
DRIVERS: dict[str, tuple[str, dict[str, Any]]] = {
    'model': ('pyracerz_carracing', {}),
    'raw': ('pyracerz_raw', {'scale': 5.466, 'stretch': 0.8}),
    # a model that learned in this profile
    'trained': ('pyracerz_raw', {}),
    'random': ('pyracerz_carracing', {}),
    'robot': ('pyracerz_carracing', {'driver': 'robot'}),
}
# frames to a picture of a film, and pixels of it to one of the frame
FILM_EVERY, FILM_ZOOM = 4, 3
LIMIT_SECONDS, STANDING_SECONDS = 25.0, 5.0
# seeds below were used for choosing the profile
FIRST_SEED = 1000


class _Nobody:
    """Stands by while the game's robot drives."""

    looks_at_frames = False

    def reset(self, seed: int | None = None) -> None:
        """Forget nothing."""

    def act(self, _: Any) -> Any:
        """Return what nobody obeys."""
        return STOP


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 0."""
    parser = argparse.ArgumentParser(prog='bench_pyracerz', description=__doc__)
    parser.add_argument('--model', default='racing', help='who is tried (default racing)')
    parser.add_argument('--starts', type=int, default=24, help='starts of each row (default 24)')
    parser.add_argument('--seed', type=int, default=FIRST_SEED,
                        help=f'seed of the first start (default {FIRST_SEED})')
    parser.add_argument('--tracks', nargs='+', choices=TRACKS, default=TRACKS, metavar='TRACK')
    parser.add_argument('--drivers', nargs='+', choices=DRIVERS, metavar='DRIVER',
                        default=('model', 'raw', 'random', 'robot'),
                        help=f'of {", ".join(DRIVERS)}; trained: a --model that learned in '
                             'pyracerz_raw')
    parser.add_argument('--json', metavar='FILE', help='write every start there too')
    parser.add_argument('--film', metavar='FILE', help='write the first lap of the model on the '
                        'first track as moving pictures (.webp) instead, raw and as it saw them')
    options = parser.parse_args(arguments)
    if options.film:
        return film(options)
    rows = []
    show('| driver | track | direction | laps | median lap, s | off the road | failures |')
    show('|---|---|---|---:|---:|---:|---|')
    for name, track, direction in itertools.product(
            options.drivers, options.tracks, DIRECTIONS):
        starts = drive(name, track, direction, options)
        rows.append({'driver': name, 'track': track, 'direction': direction, 'starts': starts})
        show(line(rows[-1]))
        if options.json:
            Path(options.json).write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')
    return 0


def drive(
    name: str, track: str, direction: str, options: argparse.Namespace,
) -> list[dict[str, float]]:
    """Drive the starts of one row; return what became of each."""
    profile, settings = DRIVERS[name]
    simulator = make_simulator(profile, {**settings, 'track': track, 'direction': direction})
    limit, standing = (round(seconds / simulator.frame_seconds)
                       for seconds in (LIMIT_SECONDS, STANDING_SECONDS))
    policy: Any = _Nobody() if name == 'robot' else parse_policy(
        RANDOM if name == 'random' else 'model', options.model).open(simulator.frame_seconds)
    every = looks_every(policy)
    starts = []
    for seed in range(options.seed, options.seed + options.starts):
        outcome = simulator.reset(seed)
        policy.reset(seed)
        frame, frames, most = outcome.pixels, 0, 0.0
        while not (outcome.terminated or outcome.truncated or frames >= limit
                   or outcome.info['standing_still'] >= standing):
            command = checked_command(policy.act(frame))
            frames += 1
            outcome = simulator.advance(command, draw=every > 0 and frames % every == 0)
            frame = frame if outcome.pixels is None else outcome.pixels
            most = max(most, outcome.info['checkpoint'])
        seconds = frames * simulator.frame_seconds
        starts.append({
            'seed': seed, 'lap_finished': bool(outcome.info['lap_finished']),
            'lap_seconds': round(outcome.info['lap_seconds'], 2), 'seconds': round(seconds, 2),
            'off_road_seconds': round(outcome.info['off_road_seconds'], 2),
            'checkpoints': most, 'checkpoints_total': simulator.constants['checkpoints_total'],
            'stood': bool(outcome.info['standing_still'] >= standing)})
    simulator.close()
    return starts


def film(options: argparse.Namespace) -> int:
    """Film a lap; return 1 if none of the starts ends with one."""
    # the same start and commands are the same drive, however it is drawn
    settings = {'track': options.tracks[0]}
    seen = make_simulator('pyracerz_carracing', settings)
    raw = make_simulator('pyracerz_carracing', {**settings, 'picture': 'raw'})
    policy = parse_policy('model', options.model).open(seen.frame_seconds)
    for seed in range(options.seed, options.seed + options.starts):
        outcomes, pictures, frames = [raw.reset(seed), seen.reset(seed)], [], 0
        policy.reset(seed)
        while not (outcomes[1].terminated or outcomes[1].truncated):
            if frames % FILM_EVERY == 0:
                pair = np.concatenate([one.pixels for one in outcomes], axis=1)
                pictures.append(Image.fromarray(pair).resize(
                    (FILM_ZOOM * pair.shape[1], FILM_ZOOM * pair.shape[0]),
                    Image.Resampling.NEAREST))
            command = checked_command(policy.act(outcomes[1].pixels))
            outcomes = [one.advance(command) for one in (raw, seen)]
            frames += 1
        if outcomes[1].terminated:
            pictures[0].save(
                options.film, save_all=True, append_images=pictures[1:], loop=0, quality=50,
                method=4, duration=round(1000 * FILM_EVERY * seen.frame_seconds))
            show(f'{options.film}: seed {seed}, {outcomes[1].info["lap_seconds"]:.2f} s')
            return 0
    show('no start ended with a lap')
    return 1


def line(row: dict[str, Any]) -> str:
    """Return a row as a line of the table."""
    starts = row['starts']
    laps = [one['lap_seconds'] for one in starts if one['lap_finished']]
    failed = [one for one in starts if not one['lap_finished']]
    off = sum(one['off_road_seconds'] for one in starts) / sum(one['seconds'] for one in starts)
    failures = ''
    if failed:
        stood = sum(one['stood'] for one in failed)
        share = statistics.mean(
            one['checkpoints'] / one['checkpoints_total'] for one in failed)
        failures = (f'{stood} stood still, {len(failed) - stood} out of time; '
                    f'{share:.0%} of a lap on average')
    return (f'| {row["driver"]} | {row["track"]} | {row["direction"]} | {len(laps)} of '
            f'{len(starts)} | {f"{statistics.median(laps):.1f}" if laps else "-"} | {off:.0%} | '
            f'{failures} |')


def show(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + '\n')
    sys.stdout.flush()


if __name__ == '__main__':
    sys.exit(main())
