# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a policy of CarRacing is worth with a worse camera, a slower link, or other colours.

The same greedy laps under each condition, one attempt a track. A condition changes what the
policy sees and when; the car, the tracks and the rewards stay. Between images that arrive the last
command is held, as the policy node does it.
"""
from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Sequence
import dataclasses
import json
from pathlib import Path
import sys
from typing import Any

from carracing_dqn.evaluation.laps import drive_lap, Lap
from carracing_dqn.evaluation.policies import model_source
from carracing_dqn.evaluation.statistics import statistics_of
from carracing_dqn.evaluation.workers import limit_torch_threads
from carracing_dqn.simulation import make_simulator
from dqn_policy_node.action_hold import ActionHold
from dqn_policy_node.policy import Policy
from msgs_bridge.atomic_write import write_text
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.twists import Command, STOP
import numpy as np
from rich.console import Console
from rich.table import Table


@dataclasses.dataclass(frozen=True)
class Condition:
    """
    What is between the simulator's picture and the policy.

    Attributes:
        noise: standard deviation of each pixel's value, of 255.
        brightness: every lap's pictures are brighter or darker by up to this share.
        blur: pictures are means over squares of so many pixels.
        lost: share of the pictures that never arrive.
        late: simulated frames that a picture takes to arrive.
        rate: pictures a second; 0 = every simulated frame.
        settings: of the simulator, where they differ.
    """

    noise: float = 0.0
    brightness: float = 0.0
    blur: int = 0
    lost: float = 0.0
    late: int = 0
    rate: float = 0.0
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)


CONDITIONS = {
    'as it is': Condition(),
    'noise of 10 of 255': Condition(noise=10.0),
    'noise of 25 of 255': Condition(noise=25.0),
    'brightness ± 30 %': Condition(brightness=0.3),
    'blur over 3 x 3 pixels': Condition(blur=3),
    '1 picture in 20 lost': Condition(lost=0.05),
    '1 picture in 3 lost': Condition(lost=1 / 3),
    '1 frame late (20 ms)': Condition(late=1),
    '2 frames late (40 ms)': Condition(late=2),
    '4 frames late (80 ms)': Condition(late=4),
    '30 pictures/s': Condition(rate=30.0),
    '15 pictures/s': Condition(rate=15.0),
    'other colours (domain_randomize)': Condition(settings={'domain_randomize': True}),
}


class Disturbed:
    """A policy behind a condition; looks at every frame, as a camera does."""

    def __init__(self, policy: Policy, condition: Condition, frame_seconds: float) -> None:
        """Put a condition before a policy that gets a frame every `frame_seconds`."""
        self._policy, self._condition = policy, condition
        self._frame = round(frame_seconds * NANOSECONDS)
        self.reset(0)

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode; what is random in the condition follows the seed."""
        self._policy.reset(seed)
        self._random = np.random.default_rng([seed or 0, 0x0B05])
        limit = self._condition.brightness
        self._gain = 1.0 + self._random.uniform(-limit, limit)
        self._hold = ActionHold()
        self._on_the_way: deque[np.ndarray] = deque(maxlen=self._condition.late + 1)
        self._command: Command = STOP
        self._now, self._pictures, self._decided = -self._frame, 0, None

    def act(self, frame: np.ndarray) -> Command:
        """Return the command for a frame, uint8 (H, W, 3) rgb, one every `frame_seconds`."""
        condition = self._condition
        self._now += self._frame
        self._on_the_way.append(frame)
        if len(self._on_the_way) <= condition.late:
            return self._command
        if condition.rate and self._now * condition.rate < self._pictures * NANOSECONDS:
            return self._command
        self._pictures += 1
        if self._random.random() < condition.lost:
            return self._command
        if self._hold.is_due(self._now, round(self._policy.action_seconds * NANOSECONDS)):
            elapsed = None if self._decided is None else self._now - self._decided
            self._decided = self._now
            self._command = self._policy.decide(
                self._seen(self._on_the_way[0]), elapsed).command
        return self._command

    def _seen(self, frame: np.ndarray) -> np.ndarray:
        condition = self._condition
        if not (condition.noise or condition.brightness or condition.blur):
            return frame
        seen = frame.astype(np.float32) * self._gain
        if condition.blur:
            # an edge of the picture goes on as it is
            reach = condition.blur // 2
            wide = np.pad(seen, ((reach, reach), (reach, reach), (0, 0)), mode='edge')
            seen = np.lib.stride_tricks.sliding_window_view(
                wide, (condition.blur, condition.blur), axis=(0, 1)).mean(axis=(-2, -1))
        if condition.noise:
            seen = seen + self._random.normal(0.0, condition.noise, seen.shape)
        return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def drive(model: str, condition: Condition, seeds: range, simulator: str) -> list[Lap]:
    """Drive a lap of each seed with a model under a condition."""
    made = make_simulator(simulator, condition.settings)
    policy = model_source(model).open(made.frame_seconds)
    disturbed = Disturbed(policy, condition, made.frame_seconds)
    return [drive_lap(made, disturbed, seed) for seed in seeds]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 0."""
    parser = argparse.ArgumentParser(prog='carracing bench robustness', description=__doc__)
    parser.add_argument('--model', default='racing', help='who drives (default: %(default)s)')
    parser.add_argument('--laps', type=int, default=50, help='of each row (default: %(default)s)')
    parser.add_argument('--seed', type=int, default=100_000,
                        help='seed of the first track (default: %(default)s)')
    parser.add_argument('--simulator', choices=('fast', 'gymnasium'), default='fast',
                        help='of CarRacing (default: %(default)s)')
    parser.add_argument('--only', action='append', choices=CONDITIONS, metavar='CONDITION',
                        help=f'may be given several times; of: {"; ".join(CONDITIONS)}')
    parser.add_argument('--json', type=Path, help='write every lap there, too')
    options = parser.parse_args(arguments)
    limit_torch_threads()
    table = Table(title=f'{options.model}: {options.laps} greedy laps from seed {options.seed}')
    for column in ('condition', 'mean', 'spread', 'lowest', 'laps\n%', 'frames\na lap'):
        table.add_column(column, justify='left' if column == 'condition' else 'right')
    rows: dict[str, list[dict[str, Any]]] = {}
    for name in options.only or CONDITIONS:
        laps = drive(options.model, CONDITIONS[name],
                     range(options.seed, options.seed + options.laps), options.simulator)
        rows[name] = [dataclasses.asdict(lap) for lap in laps]
        all_of = statistics_of(laps)
        table.add_row(
            name, f'{all_of.mean:.1f}', f'{all_of.std:.1f}', f'{all_of.minimum:.1f}',
            f'{100 * all_of.completed:.0f}',
            '-' if all_of.lap_frames is None else f'{all_of.lap_frames:.0f}')
        if options.json:
            write_text(options.json, json.dumps(rows, indent=1) + '\n')
    Console().print(table)
    return 0


if __name__ == '__main__':
    sys.exit(main())
