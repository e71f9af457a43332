# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What few runs say of many: interquartile mean, probability of improvement, bootstrap intervals.

After "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (arXiv 2108.13264)
and its library rliable, with the test tracks as tasks. One thing is different: rliable draws the
runs anew for each task, as if every game had been learned on its own. Here one set of weights
drives all tracks, so whole runs are drawn; what is left of three seeds is as uncertain as it is.
"""
from __future__ import annotations

from collections.abc import Callable
import dataclasses
import itertools
import math

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 5000
EXACT = 20_000
"""Ways to share runs out that are all looked at."""

_SEED = 0


@dataclasses.dataclass(frozen=True)
class Estimate:
    """
    A figure and its 95 % interval.

    Attributes:
        value: of the sample.
        low, high: percentile bootstrap over runs; None where a single run says nothing of it.
    """

    value: float
    low: float | None = None
    high: float | None = None


def interquartile_mean(scores: np.ndarray) -> float:
    """
    Return the mean of the middle half of all scores.

    Args:
        scores: float (runs, tracks); the lowest and the highest quarter are left out, each
            rounded down, as scipy's `trim_mean` does.
    """
    flat = np.sort(scores, axis=None)
    cut = int(0.25 * flat.size)
    return float(flat[cut:flat.size - cut].mean())


def estimate(scores: np.ndarray, statistic: Callable[[np.ndarray], float]) -> Estimate:
    """Return a statistic of scores, float (runs, tracks), with its interval over runs."""
    value = statistic(scores)
    if len(scores) < 2:
        return Estimate(value)
    random = np.random.default_rng(_SEED)
    drawn = random.integers(len(scores), size=(RESAMPLES, len(scores)))
    # of few runs there are few different draws
    kinds, which = np.unique(np.sort(drawn, axis=1), axis=0, return_inverse=True)
    values = np.array([statistic(scores[rows]) for rows in kinds])[which.ravel()]
    return Estimate(value, *_interval(values))


def improvement(scores: np.ndarray, others: np.ndarray) -> Estimate:
    """
    Return how likely a run of one kind does better than one of another on the same track.

    Ties count half (Mann and Whitney 1947, as in the paper).

    Args:
        scores: float (runs, tracks).
        others: float (runs, tracks), of the same tracks.
    """
    wins = np.array([(np.greater(one, others) + 0.5 * np.equal(one, others)).mean(axis=1)
                     for one in scores])
    if min(wins.shape) < 2:
        return Estimate(float(wins.mean()))
    random = np.random.default_rng(_SEED)
    # how often each run is drawn weighs what it won: hundreds of runs squared are not kept
    rows, columns = (_times_drawn(random, runs) for runs in wins.shape)
    values = (rows @ wins * columns).sum(axis=1) / wins.size
    return Estimate(float(wins.mean()), *_interval(values))


def permutation_p(scores: np.ndarray, others: np.ndarray) -> float:
    """
    Return how often means differ as much as these when runs are shuffled among the two kinds.

    Exact where there are few enough ways to share them out; what cannot be told apart with so few
    runs shows: of three against three none is rarer than 0.1.

    Args:
        scores: float (runs, tracks).
        others: float (runs, tracks).
    """
    means = np.concatenate([scores.mean(axis=1), others.mean(axis=1)])
    count, chosen = len(means), len(scores)
    if math.comb(count, chosen) <= EXACT:
        rows = np.array(list(itertools.combinations(range(count), chosen)))
    else:
        random = np.random.default_rng(_SEED)
        rows = random.permuted(np.tile(np.arange(count), (RESAMPLES, 1)), axis=1)[:, :chosen]
        # the one that was seen is one of the ways, too
        rows = np.concatenate([np.arange(chosen)[None], rows])
    sums = means[rows].sum(axis=1)
    differences = np.abs(sums / chosen - (means.sum() - sums) / (count - chosen))
    seen = abs(means[:chosen].mean() - means[chosen:].mean())
    # the one that was seen differs by rounding, which grows with the returns
    return float(np.mean(differences >= seen - 1e-9 * max(1.0, np.abs(means).max())))


def _times_drawn(random: np.random.Generator, runs: int) -> np.ndarray:
    """Return how often each run is in each resample: int (resamples, runs)."""
    drawn = random.integers(runs, size=(RESAMPLES, runs)) + runs * np.arange(RESAMPLES)[:, None]
    return np.bincount(drawn.ravel(), minlength=drawn.size).reshape(drawn.shape)


def _interval(values: np.ndarray) -> tuple[float, float]:
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, (tail, 1 - tail))
    return float(low), float(high)
