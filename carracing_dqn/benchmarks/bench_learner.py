# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
`carracing bench learner`: updates a second, against Stable-Baselines3's DQN.

Both learn with the same network (Nature: 32@8/4 64@4/2 64@3/1, 512) from the same transitions of
a car that acts at random (4x84x84), batch 32, one thread, plain DQN with Huber loss, sampling from
the replay buffer included. They take turns within each round; figures are medians over rounds,
ratios are taken within a round. A learner that has learned for a while may be slower than a new
one: `--after` so many updates of each. The share of the core's matrix rate is the arithmetic of an
update against a matrix product measured in the same round. `--calls` tells what an update's time
goes to.
"""
from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Callable
import dataclasses
import json
import os
from pathlib import Path
from statistics import median
import sys
import time
from typing import Any

import numpy as np
import torch
from torch.profiler import profile, ProfilerActivity

from carracing_dqn.simulation import open_drive
from dqn_policy_node.action_space import action_space, DUMMY_SPACE
from dqn_policy_node.model_description import ModelDescription
from dqn_policy_node.preprocessing import Preprocessor
from msgs_bridge.machine import describe_machine
from trainer_node.hyperparameters import Hyperparameters, load_preset
from trainer_node.learner import make_learner
from trainer_node.replay_buffer import ReplayBuffer

SIDE, STACK, BATCH = 84, 4, 32
HELD, REPEAT = 3000, 4
MATRIX = 1024
SB3 = 'stable-baselines3'
# with what `flush_denormals` is against
KEEPING = ', denormals'
# what PyTorch's operations are for, by the ends of their names, the first that fits
KINDS = {
    'convolutions backward': ('convolution_backward',),
    'convolutions forward': ('convolution', 'conv2d'),
    'matrix products': ('mm', 'linear'),
    'Adam': ('adam_', 'Adam.step'),
    'copies, casts': ('copy_', 'clone', 'to', 'fill_', 'zero_', 'cat', 'stack'),
    'weight average': ('lerp_',),
    'gradient norm': ('norm',),
}
OTHER, OUTSIDE = 'other operations', 'outside PyTorch'

Update = Callable[[], Any]


@dataclasses.dataclass(frozen=True)
class Decision:
    """
    What one decision led to.

    Attributes:
        action: index in `DUMMY_SPACE`.
        reward: of its frames.
        pixels: the frame after it, uint8 (96, 96, 3) rgb.
        first: whether `pixels` begins an episode, and nothing was decided.
        terminated: whether it ended one for good.
    """

    action: int
    reward: float
    pixels: np.ndarray
    first: bool
    terminated: bool


def nature(*, bf16: bool) -> Hyperparameters:
    """Return plain DQN on the Nature network."""
    return Hyperparameters(
        rows=SIDE, columns=SIDE, frame_stack=STACK, action_repeat=REPEAT, loss='huber', bf16=bf16,
        batch_size=BATCH, target_update='updates', target_every=10_000)


def driven(count: int) -> list[Decision]:
    """Return what a car saw that acts at random for so many decisions in CarRacing."""
    random = np.random.default_rng(0)
    drive = open_drive({'seed': 42, 'action_repeat': REPEAT})
    decisions: list[Decision] = []
    frame = None
    try:
        while len(decisions) < count:
            if frame is None or frame.step.ended:
                frame = drive.begin()
                decisions.append(Decision(0, 0.0, frame.pixels, first=True, terminated=False))
            action = int(random.integers(len(DUMMY_SPACE)))
            frame = drive.advance(DUMMY_SPACE.commands[action], frame.stamp)
            decisions.append(Decision(
                action, frame.step.reward, frame.pixels, first=False,
                terminated=frame.step.terminated))
    finally:
        drive.close()
    return decisions


def ours(settings: Hyperparameters, decisions: list[Decision]) -> Update:
    """Return a function that samples and makes one update with our learner."""
    torch.manual_seed(0)
    learner = make_learner(settings, 'cpu')
    description = settings.model_description()
    buffer = ReplayBuffer(
        len(decisions), description.preprocessing.shape, frame_stack=settings.frame_stack,
        n_steps=settings.n_steps, gamma=settings.gamma)
    random = np.random.default_rng(0)
    see = Preprocessor(description.preprocessing)
    # of other spaces the action is another one, which costs the same
    actions = len(action_space(settings.action_space))
    for decision in decisions:
        observation = see(decision.pixels)
        if decision.first:
            buffer.start(observation)
        else:
            buffer.add(decision.action % actions, decision.reward, observation,
                       terminated=decision.terminated)
    return lambda: learner.update(
        buffer.sample(settings.batch_size, random), settings.learning_rate)


def stable_baselines(decisions: list[Decision]) -> Update | None:
    """Return one update of Stable-Baselines3's DQN, None if it is not installed."""
    try:
        import gymnasium
        from stable_baselines3 import DQN
        from stable_baselines3.common.logger import configure
    except ImportError:
        return None

    class Still(gymnasium.Env):
        """Spaces and nothing else."""

        observation_space = gymnasium.spaces.Box(0, 255, (STACK, SIDE, SIDE), np.uint8)
        action_space = gymnasium.spaces.Discrete(len(DUMMY_SPACE))

    model = DQN('CnnPolicy', Still(), buffer_size=len(decisions), batch_size=BATCH, device='cpu',
                seed=0, target_update_interval=10_000)
    model.set_logger(configure(None, []))
    see = Preprocessor(nature(bf16=False).model_description().preprocessing)
    stack: deque[np.ndarray] = deque(maxlen=STACK)
    for decision in decisions:
        observation = see(decision.pixels)
        if decision.first:
            stack.extend([observation] * STACK)
            continue
        before = np.stack(stack)[None]
        stack.append(observation)
        model.replay_buffer.add(
            before, np.stack(stack)[None], np.array([[decision.action]]),
            np.array([decision.reward]), np.array([decision.terminated]), [{}])
    torch.set_num_threads(1)
    return lambda: model.train(gradient_steps=1, batch_size=BATCH)


def update_operations(description: ModelDescription, batch: int, *, double: bool) -> float:
    """Return the multiplications and additions of one update's matrix work."""
    height, width = description.preprocessing.shape
    channels, layers = description.frame_stack, []
    for layer in description.network.convolutions:
        height = (height - layer.kernel) // layer.stride + 1
        width = (width - layer.kernel) // layer.stride + 1
        layers.append(height * width * layer.filters * channels * layer.kernel ** 2)
        channels = layer.filters
    hidden = description.network.hidden
    outputs = len(description.action_space) * description.network.quantiles
    layers += [channels * height * width * hidden, hidden * outputs]
    forward = 2 * batch * sum(layers)
    # target forward, online forward, gradient by weights and by inputs (not by the observations)
    return forward * (4 + double) - 2 * batch * layers[0]


def matrix_rates() -> dict[str, float]:
    """Return operations a second of a matrix product on one core, by type."""
    rates = {}
    for name, kind in (('float32', torch.float32), ('bfloat16', torch.bfloat16)):
        matrix = torch.randn(MATRIX, MATRIX).to(kind)
        matrix @ matrix
        times = []
        for _ in range(5):
            started = time.perf_counter()
            matrix @ matrix
            times.append(time.perf_counter() - started)
        rates[name] = 2 * MATRIX ** 3 / min(times)
    return rates


def rate(update: Update, count: int) -> float:
    """Return updates a second over `count` updates."""
    started = time.perf_counter()
    for _ in range(count):
        update()
    return count / (time.perf_counter() - started)


def calls(update: Update, count: int) -> dict[str, list[float]]:
    """
    Return what the time of an update goes to: kind -> its ms and its calls.

    PyTorch's profiler makes each call longer, the short ones most. What no operation took is
    outside PyTorch: sampling, and Python.
    """
    with profile(activities=[ProfilerActivity.CPU]) as profiled:
        left = 1000 / rate(update, count)
    found = {kind: [0.0, 0.0] for kind in (*KINDS, OTHER, OUTSIDE)}
    for event in profiled.key_averages():
        kind = next((kind for kind, ends in KINDS.items() if event.key.endswith(ends)), OTHER)
        milliseconds = event.self_cpu_time_total / 1000 / count
        found[kind][0] += milliseconds
        found[kind][1] += event.count / count
        left -= milliseconds
    found[OUTSIDE][0] = max(left, 0.0)
    return found


def run(
    *, rounds: int = 5, updates: int = 60, after: int = 0, by_call: bool = False,
) -> dict[str, Any]:
    """
    Measure everything; return JSON values.

    Args:
        rounds: rounds in which all take their turn.
        updates: updates of each in a round.
        after: updates of each before the first round.
        by_call: whether to tell what each one's time goes to, after the rounds.
    """
    torch.set_num_threads(1)
    racing = load_preset('racing')
    decisions = driven(HELD)
    presets = {
        'ours bf16': nature(bf16=True), 'ours float32': nature(bf16=False),
        'racing preset': racing}
    presets |= {name + KEEPING: dataclasses.replace(preset, flush_denormals=False)
                for name, preset in presets.items()}
    contestants = {
        **{name: ours(preset, decisions) for name, preset in sorted(presets.items())},
        SB3: stable_baselines(decisions),
    }
    contestants = {name: update for name, update in contestants.items() if update}
    for update in contestants.values():
        rate(update, 5 + after)
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    machine: dict[str, list[float]] = {'float32': [], 'bfloat16': []}
    for _ in range(rounds):
        for name, update in contestants.items():
            rates[name].append(rate(update, updates))
        for name, value in matrix_rates().items():
            machine[name].append(value)
    report = nature(bf16=True).model_description()
    operations = {
        'ours bf16': update_operations(report, BATCH, double=False),
        'ours float32': update_operations(report, BATCH, double=False),
        'racing preset': update_operations(
            racing.model_description(), racing.batch_size, double=racing.double),
    }
    result: dict[str, Any] = {
        'updates_per_second': {name: median(values) for name, values in rates.items()},
        'matrix_rate_gflops': {name: median(values) / 1e9 for name, values in machine.items()},
        'share_of_matrix_rate': {
            name: median(
                own * operations[name] / peak for own, peak in zip(
                    rates[name],
                    machine['float32' if name == 'ours float32' else 'bfloat16']))
            for name in operations},
        'rounds': rounds, 'updates': updates, 'after': after, 'machine': describe_machine(),
        'load_average_after': list(os.getloadavg()),
    }
    if SB3 in rates:
        result['times_stable_baselines3'] = {
            name: median(own / theirs for own, theirs in zip(rates[name], rates[SB3]))
            for name in rates if name.startswith('ours')}
    if by_call:
        result['calls'] = {name: calls(update, updates) for name, update in contestants.items()
                           if KEEPING not in name}
    return result


def calls_table(found: dict[str, dict[str, list[float]]]) -> list[str]:
    """Return the lines that show what `calls` returned for each contestant, by name."""
    rows = [['ms (calls, nested too)', *found]]
    for kind in (*KINDS, OTHER, OUTSIDE):
        cells = (by_kind[kind] for by_kind in found.values())
        rows.append([kind, *(f'{ms:.2f} ({number:.0f})' for ms, number in cells)])
    return [f'{kind:22}' + ''.join(f'{cell:>19}' for cell in cells) for kind, *cells in rows]


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark from the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='carracing bench learner', description=__doc__.strip().splitlines()[0])
    parser.add_argument('--rounds', type=int, default=5, help='rounds to take the median of')
    parser.add_argument('--updates', type=int, default=60, help='updates of each in a round')
    parser.add_argument('--after', type=int, default=0,
                        help='updates of each before the first round')
    parser.add_argument('--calls', action='store_true',
                        help="tell what an update's time goes to, by PyTorch's profiler")
    parser.add_argument('--json', type=Path, help='file to write the figures to')
    args = parser.parse_args(argv)
    if args.rounds < 1 or args.updates < 1 or args.after < 0:
        parser.error('--rounds and --updates must be at least 1, --after at least 0')
    result = run(
        rounds=args.rounds, updates=args.updates, after=args.after, by_call=args.calls)
    lines = [f'{"":26}{"updates/s":>12}{"of matrix rate":>16}{"x SB3":>8}']
    for name, value in result['updates_per_second'].items():
        share = result['share_of_matrix_rate'].get(name)
        times = result.get('times_stable_baselines3', {}).get(name)
        lines.append(f'{name:26}{value:12.1f}{f"{share:.0%}" if share else "":>16}'
                     f'{f"{times:.2f}" if times else "":>8}')
    if SB3 not in result['updates_per_second']:
        lines.append(f'{SB3} is not installed, so its row is missing: pip install {SB3}')
    lines += calls_table(result.get('calls', {})) if args.calls else []
    sys.stdout.write('\n'.join(lines) + '\n')
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
