# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a run measured for every figure of the seed document, and whether it meets the aims."""
from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math

from carracing_dqn.evaluation.records import Run
from carracing_dqn.evaluation.results import Results
from carracing_dqn.evaluation.seed_document import FIGURES, Figure, Objective, OBJECTIVES
from carracing_dqn.evaluation.statistics import moving_average, Statistics
from msgs_bridge.plain_text import plain
import numpy as np

LONGEST_WINDOW = 100
TEST_LAPS = 100


@dataclasses.dataclass(frozen=True)
class Measured:
    """
    A figure of ours.

    Attributes:
        text: as it is shown.
        value: as a number; None when there is none, and `text` says why.
    """

    text: str
    value: float | None = None


@dataclasses.dataclass(frozen=True)
class Verdict:
    """
    An objective judged.

    Attributes:
        objective: which one.
        passed: None when it cannot be judged.
        text: the figures that decide.
    """

    objective: Objective
    passed: bool | None
    text: str

    @property
    def word(self) -> str:
        """Return the verdict in a word."""
        return {True: 'pass', False: 'fail', None: 'not judged'}[self.passed]


class _NotMeasured(Exception):
    """A figure that the records of a run do not give; the text says why."""


def _percent(share: float | None) -> float:
    if share is None:
        raise _NotMeasured('the simulator does not say')
    return 100 * share


def smoothing_window(episodes: int) -> int:
    """Return the window of the moving average: a tenth of the episodes, at most 100."""
    return max(1, min(LONGEST_WINDOW, episodes // 10))


def measure(figure: Figure, run: Run) -> Measured:
    """Return what a run has for a figure of the document."""
    try:
        if figure.key.startswith('config.'):
            return _setting(figure.key.removeprefix('config.'), run)
        value = float(_MEASURES[figure.key](run))
    except _NotMeasured as reason:
        return Measured(f'– ({reason})')
    return Measured(_shown(value, figure.unit), value)


def compare(run: Run) -> list[tuple[Figure, Measured]]:
    """Return every figure of the document beside that of a run in CarRacing."""
    return [(figure, measure(figure, run)) for figure in FIGURES if run.in_carracing]


def judge(run: Run) -> list[Verdict]:
    """Return the four objectives of section 1.2, judged; none of a run in another simulator."""
    verdicts = []
    for objective in OBJECTIVES if run.in_carracing else ():
        try:
            passed, text = _JUDGES[objective.key](run)
        except _NotMeasured as reason:
            passed, text = None, str(reason)
        verdicts.append(Verdict(objective, passed, text))
    return verdicts


def _shown(value: float, unit: str) -> str:
    if unit == '%':
        return f'{value:.4g} %'
    if unit in ('episodes', 'laps'):
        return f'{value:.0f}'
    if unit == 'h':
        return f'{value:.2f} h' if value >= 1 else f'{60 * value:.1f} min'
    if unit in ('points', 'frames'):
        return f'{value:.2f}'
    return f'{value:.4g}'


# Training and validation. ----------------------------------------------------------------------

def _rewards(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return episode numbers and rewards, each float (n,)."""
    if not run.episodes.has('train_reward'):
        raise _NotMeasured('no training episodes')
    if not run.episodes.has('episode'):
        rewards, = run.episodes.known('train_reward')
        return np.arange(len(rewards), dtype=float), rewards
    numbers, rewards = run.episodes.known('episode', 'train_reward')
    return numbers, rewards


def _validations(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return episode numbers and validation means, each float (n,)."""
    if run.validation.has('episode', 'mean'):
        episodes, means = run.validation.known('episode', 'mean')
        return episodes, means
    if run.episodes.has('episode', 'validation_reward'):
        episodes, means = run.episodes.known('episode', 'validation_reward')
        return episodes, means
    raise _NotMeasured('no validation')


def _average_passes(run: Run, level: float) -> float:
    """Return the first episode at which the moving average over a whole window is above."""
    numbers, rewards = _rewards(run)
    window = smoothing_window(len(rewards))
    above = moving_average(rewards, window) > level
    above[:window - 1] = False
    if not above.any():
        raise _NotMeasured('never')
    return numbers[np.argmax(above)]


def _average_at_end(run: Run) -> float:
    _, rewards = _rewards(run)
    return moving_average(rewards, smoothing_window(len(rewards)))[-1]


def _lowest_after_best(run: Run) -> float:
    _, rewards = _rewards(run)
    after = rewards[np.argmax(rewards) + 1:]
    if not len(after):
        raise _NotMeasured('the best was the last')
    return after.min()


def _hours(run: Run) -> float:
    seconds = run.wall_seconds
    if seconds is None:
        raise _NotMeasured('no record of the time')
    return seconds / 3600


def _validation_at(run: Run, episode: int) -> float:
    """Return the first validation at or after an episode."""
    episodes, means = _validations(run)
    later = np.flatnonzero(episodes >= episode)
    if not len(later):
        raise _NotMeasured(f'none at episode {episode}')
    return means[later[0]]


def _validations_above(run: Run, level: float) -> float:
    """Return the episode from which on all validations are above a level."""
    episodes, means = _validations(run)
    below = np.flatnonzero(means <= level)
    first = below[-1] + 1 if len(below) else 0
    if first == len(means):
        raise _NotMeasured('the last is not')
    return episodes[first]


def _last_learning_rate(run: Run) -> float:
    for table in (run.updates, run.episodes):
        if table.has('learning_rate'):
            return table.known('learning_rate')[0][-1]
    raise _NotMeasured('no record')


# Test laps. ------------------------------------------------------------------------------------

def _statistics(results: Results | None, who: str) -> Statistics:
    if results is None or not results.laps:
        raise _NotMeasured(f'no laps of the {who}; see carracing evaluate')
    return results.statistics


def _dummy(run: Run) -> Statistics:
    return _statistics(run.dummy, 'dummy agent')


def _test(run: Run) -> Statistics:
    return _statistics(run.evaluation, 'trained agent')


def _increase(run: Run) -> float:
    """Return the increase over the dummy agent in percent of its absolute mean."""
    dummy = _dummy(run).mean
    if dummy == 0:
        raise _NotMeasured('the dummy agent has a mean of 0')
    return 100 * (_test(run).mean - dummy) / abs(dummy)


_MEASURES: dict[str, Callable[[Run], float]] = {
    'train_first': lambda run: _rewards(run)[1][0],
    'train_average_zero': lambda run: _average_passes(run, 0),
    'train_average_800': lambda run: _average_passes(run, 800),
    'train_average_last': _average_at_end,
    'train_maximum': lambda run: _rewards(run)[1].max(),
    'train_maximum_episode': lambda run: _rewards(run)[0][np.argmax(_rewards(run)[1])],
    'train_dips': _lowest_after_best,
    'train_last': lambda run: _rewards(run)[1][-1],
    'train_mean': lambda run: _rewards(run)[1].mean(),
    'episodes': lambda run: len(_rewards(run)[1]),
    'hours': _hours,
    'validation_first': lambda run: _validations(run)[1][0],
    'validation_700': lambda run: _validation_at(run, 700),
    'validation_above_800': lambda run: _validations_above(run, 800),
    'validation_maximum': lambda run: _validations(run)[1].max(),
    'validation_maximum_episode':
        lambda run: _validations(run)[0][np.argmax(_validations(run)[1])],
    'validation_last': lambda run: _validations(run)[1][-1],
    'validation_mean': lambda run: _validations(run)[1].mean(),
    'dummy_mean': lambda run: _dummy(run).mean,
    'dummy_std': lambda run: _dummy(run).std,
    'dummy_minimum': lambda run: _dummy(run).minimum,
    'dummy_maximum': lambda run: _dummy(run).maximum,
    'dummy_completed': lambda run: _percent(_dummy(run).completed),
    'dummy_700': lambda run: 100 * _dummy(run).success[700],
    'dummy_800': lambda run: 100 * _dummy(run).success[800],
    'dummy_900': lambda run: 100 * _dummy(run).success[900],
    'test_episodes': lambda run: _test(run).episodes,
    'test_mean': lambda run: _test(run).mean,
    'test_std': lambda run: _test(run).std,
    'test_minimum': lambda run: _test(run).minimum,
    'test_maximum': lambda run: _test(run).maximum,
    'test_completed': lambda run: _percent(_test(run).completed),
    'test_frames': lambda run: _test(run).frames,
    'test_700': lambda run: 100 * _test(run).success[700],
    'test_800': lambda run: 100 * _test(run).success[800],
    'test_900': lambda run: 100 * _test(run).success[900],
    'test_stopped': lambda run: _percent(_test(run).stopped),
    'test_increase': _increase,
    'learning_rate_last': _last_learning_rate,
}


# Settings. -------------------------------------------------------------------------------------

def _setting(name: str, run: Run) -> Measured:
    """Return a hyperparameter, or what takes its place in another schedule."""
    config = run.config
    if name not in config:
        return Measured('– (no record of the settings)' if not config else '– (not in the record)')
    value = config[name]
    if name == 'epsilon_decay' and config.get('epsilon_schedule') == 'decisions':
        return Measured(f'linear over {plain(config.get("epsilon_decisions"))} decisions')
    if name == 'patience_episodes' and config.get('learning_rate_schedule') != 'plateau':
        return Measured(f'{plain(config.get("learning_rate_schedule"))} learning rate instead')
    if name == 'validation_every_episodes' and value == 0:
        for unit in ('minutes', 'decisions'):
            if every := config.get(f'validation_every_{unit}'):
                return Measured(f'{every:g} {unit}' if type(every) in (int, float)
                                else plain(every))
        return Measured('only at the end')
    # what is no number may be anything, and of any length
    if type(value) not in (int, float) or not math.isfinite(value):
        return Measured(plain(value))
    text = f'{value:g}' if isinstance(value, float) else str(value)
    if name == 'target_every':
        text += f' {plain(config.get("target_update", ""))}'.rstrip()
    return Measured(text, float(value))


# Objectives. -----------------------------------------------------------------------------------

def _judge_consecutive(run: Run) -> tuple[bool, str]:
    laps = run.evaluation.ordered if run.evaluation is not None else []
    if len(laps) < TEST_LAPS:
        raise _NotMeasured(f'{len(laps)} of the {TEST_LAPS} test laps it needs')
    returns = np.array([lap.episode_return for lap in laps[:TEST_LAPS]])
    reached = int((returns >= 700).sum())
    return bool(returns.mean() >= 700), (
        f'mean {returns.mean():.2f}; taken one by one, {reached} of {TEST_LAPS} laps reach 700')


def _judge_average(run: Run) -> tuple[bool, str]:
    numbers = _test(run)
    if numbers.episodes < TEST_LAPS:
        raise _NotMeasured(f'{numbers.episodes} of the {TEST_LAPS} test laps it needs')
    return numbers.mean >= 800, (
        f'mean {numbers.mean:.2f} ± {numbers.std:.2f} over {numbers.episodes} laps')


def _judge_improvement(run: Run) -> tuple[bool, str]:
    _, rewards = _rewards(run)
    window = smoothing_window(len(rewards))
    if len(rewards) < 2:
        raise _NotMeasured('one training episode')
    first, last = rewards[:window].mean(), rewards[-window:].mean()
    return bool(last > first), (
        f'mean of the first {window} episodes {first:.2f}, of the last {window} {last:.2f}')


def _judge_baseline(run: Run) -> tuple[bool, str]:
    increase = _increase(run)
    return increase >= 50, (
        f'{_test(run).mean:.2f} against {_dummy(run).mean:.2f}: {increase:+.0f} %')


_JUDGES: dict[str, Callable[[Run], tuple[bool, str]]] = {
    'consecutive': _judge_consecutive,
    'average': _judge_average,
    'improvement': _judge_improvement,
    'baseline': _judge_baseline,
}
