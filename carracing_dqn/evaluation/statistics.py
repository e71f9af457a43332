# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a set of laps adds up to."""
from __future__ import annotations

from collections.abc import Iterable, Sequence
import dataclasses
import math

from carracing_dqn.evaluation.errors import EvaluationError
from carracing_dqn.evaluation.laps import Lap
import numpy as np

THRESHOLDS = (700, 800, 900)
"""Returns whose rate of success the report states (seed document 3.2.5)."""

QUANTILES = (0.05, 0.10, 0.25, 0.75, 0.90, 0.95)

STOPPED_FRAMES = 100
"""A car that stands still for more frames than this at the end has stopped (4.1.1)."""

CONFIDENCE = 0.95
# the normal quantile of that confidence, for the share of finished laps
_Z = 1.959963984540054
_RESAMPLES = 10_000
_RESAMPLING_SEED = 0


@dataclasses.dataclass(frozen=True)
class Statistics:
    """
    Numbers of a set of laps; None where the simulator does not say what they need.

    Attributes:
        episodes: how many laps.
        mean, std: of the returns; the standard deviation is that of the population, over n.
        mean_low, mean_high: 95 % confidence interval of the mean, percentile bootstrap with
            10,000 resamples from a fixed seed.
        median, minimum, maximum: of the returns.
        quantiles: quantile of the returns by its share, linear between laps.
        completed: share of laps with all tiles visited, 0 to 1.
        completed_low, completed_high: its 95 % confidence interval by Wilson's score.
        success: share of laps with at least the return, by threshold.
        stopped: share of laps in which the car stood still for more than 100 frames before the
            end (4.1.1).
        left_field: share of laps in which it left the playfield.
        frames: mean frames of an episode.
        lap_frames: mean frames of the finished laps; None when none was.
        tiles: mean share of the tiles that were visited, 0 to 1.
        seconds: mean wall time of an episode.
    """

    episodes: int
    mean: float
    std: float
    mean_low: float
    mean_high: float
    median: float
    minimum: float
    maximum: float
    quantiles: dict[float, float]
    completed: float | None
    completed_low: float | None
    completed_high: float | None
    success: dict[int, float]
    stopped: float | None
    left_field: float | None
    frames: float
    lap_frames: float | None
    tiles: float | None
    seconds: float

    def to_json(self) -> dict[str, object]:
        """Return the numbers as JSON values."""
        values = dataclasses.asdict(self)
        values['quantiles'] = {f'{share:g}': value for share, value in self.quantiles.items()}
        values['success'] = {str(threshold): v for threshold, v in self.success.items()}
        return values


def statistics_of(laps: Sequence[Lap]) -> Statistics:
    """
    Return the statistics of laps.

    Raises:
        EvaluationError: there is no lap.
    """
    if not laps:
        raise EvaluationError('no lap has been driven: there are no statistics of nothing')
    # in order of the seeds, so that the resampling does not depend on who was first to finish
    laps = sorted(laps, key=lambda lap: lap.seed)
    returns = np.array([lap.episode_return for lap in laps], dtype=float)
    finished = [lap.frames for lap in laps if lap.lap_finished]
    known = all(lap.lap_finished is not None for lap in laps)
    mean_low, mean_high = mean_interval(returns)
    completed_low, completed_high = (
        share_interval(len(finished), len(laps)) if known else (None, None))
    return Statistics(
        episodes=len(laps),
        mean=float(returns.mean()),
        std=float(returns.std()),
        mean_low=mean_low,
        mean_high=mean_high,
        median=float(np.median(returns)),
        minimum=float(returns.min()),
        maximum=float(returns.max()),
        quantiles={share: float(np.quantile(returns, share)) for share in QUANTILES},
        completed=len(finished) / len(laps) if known else None,
        completed_low=completed_low,
        completed_high=completed_high,
        success={
            threshold: float(np.mean(returns >= threshold)) for threshold in THRESHOLDS},
        stopped=_mean(None if lap.standing_still is None else lap.standing_still > STOPPED_FRAMES
                      for lap in laps),
        left_field=_mean(lap.left_field for lap in laps),
        frames=float(np.mean([lap.frames for lap in laps])),
        lap_frames=float(np.mean(finished)) if finished else None,
        tiles=_mean(None if lap.tiles_total is None else lap.tiles_visited / lap.tiles_total
                    for lap in laps),
        seconds=float(np.mean([lap.seconds for lap in laps])),
    )


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """
    Return the 95 % confidence interval of a mean, by the percentile bootstrap.

    Args:
        values: float (n,), n at least 1; the same values always give the same interval.
    """
    random = np.random.default_rng(_RESAMPLING_SEED)
    means = np.empty(_RESAMPLES)
    # in slices, so that ten thousand laps do not take a gigabyte
    slice_size = max(1, 2_000_000 // len(values))
    for first in range(0, _RESAMPLES, slice_size):
        count = min(slice_size, _RESAMPLES - first)
        drawn = random.integers(len(values), size=(count, len(values)))
        means[first:first + count] = values[drawn].mean(axis=1)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means, (tail, 1 - tail))
    return float(low), float(high)


def share_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a share, by Wilson's score (JASA 22, 209)."""
    share = successes / trials
    middle = share + _Z * _Z / (2 * trials)
    width = _Z * math.sqrt(share * (1 - share) / trials + _Z * _Z / (4 * trials * trials))
    scale = 1 + _Z * _Z / trials
    # at the ends the formula gives 0 and 1 but for rounding
    low = (middle - width) / scale if successes else 0.0
    high = (middle + width) / scale if successes < trials else 1.0
    return low, high


def percent(share: float) -> str:
    """Return a share, 0 to 1, in whole percent; 0 and 100 stand for none and all alone."""
    text = f'{share:.0%}'
    if text in ('0%', '100%') and 0.0 < share < 1.0:
        return f'{min(max(share, 0.001), 0.999):.1%}'
    return text


def moving_average(values: np.ndarray, window: int) -> np.ndarray:
    """
    Return the mean of each value and up to `window` - 1 before it.

    Args:
        values: float (n,); NaN is left out, and where a window has nothing else the mean is NaN.
        window: how many values at most.
    """
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    sums = np.concatenate(([0.0], np.cumsum(np.where(known, values, 0.0))))
    counts = np.concatenate(([0], np.cumsum(known)))
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    number = counts[ends] - counts[starts]
    total = sums[ends] - sums[starts]
    return np.divide(total, number, out=np.full(len(values), np.nan), where=number > 0)


def _mean(values: Iterable[float | None]) -> float | None:
    """Return a mean, None if one of the values is not known."""
    known = list(values)
    return None if None in known else float(np.mean(known))
