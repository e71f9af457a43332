# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The figure of a study: how each arm's return rose, and what its test laps gave."""
from __future__ import annotations

from collections.abc import Mapping, Sequence

from carracing_dqn.evaluation import figure_style as style
from carracing_dqn.studies.bootstrap import estimate, interquartile_mean
from carracing_dqn.studies.outcome import Curve, Outcome, scores_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator
import numpy as np

PLACES = 200
"""Points of a band."""

MOST_ARMS = 12
"""Arms that a figure can tell apart; of more, the best are drawn."""

CROWD = 6
"""Arms whose names find a place among their curves."""


def band(curves: Sequence[Curve]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return places, mean, lowest and highest return of some curves, float (PLACES,) each.

    They are drawn as far as the shortest goes, so that every point is of the same runs.

    Args:
        curves: at least one, none of them empty.
    """
    first = max(curve.places[0] for curve in curves)
    last = max(min(curve.places[-1] for curve in curves), first)
    places = np.linspace(first, last, PLACES)
    returns = np.array([np.interp(places, curve.places, curve.returns) for curve in curves])
    return places, returns.mean(axis=0), returns.min(axis=0), returns.max(axis=0)


def draw(
    arms: Mapping[str, Sequence[Outcome]], against: str, score: str,
    size: tuple[float, float] = (9.2, 4.6),
) -> Figure:
    """
    Draw the arms of a study beside each other.

    Args:
        arms: outcomes of the runs of each.
        against: what curves are drawn against, for the axis.
        score: what runs are compared by, for the axis.
        size: width and height in inches.
    """
    with style.styled():
        figure = style.new_figure(size)
        shown = _shown(arms)
        # as long as no run has been tested there is nothing to compare
        tested = any(scores_of(outcomes).size for outcomes in shown.values())
        left, right = (
            figure.subplots(1, 2, width_ratios=(3, 2)) if tested else (figure.subplots(), None))
        for number, (name, outcomes) in enumerate(shown.items()):
            again, place = divmod(number, len(style.RUN_COLOURS))
            colour = style.RUN_COLOURS[place]
            # arms of one colour differ in their dashes
            dash = style.RUN_DASHES[(place + again) % len(style.RUN_DASHES)]
            _curve(left, name, outcomes, colour, dash)
            if right is not None:
                _scores(right, number, outcomes, colour)
        left.set_xlabel(against)
        left.xaxis.set_major_locator(MaxNLocator(6))
        left.xaxis.set_major_formatter(EngFormatter(sep=''))
        left.set_ylabel('training return, mean of 20')
        if len(left.lines) > CROWD:
            # within the axes it would lie on the curves
            figure.legend(handles=left.get_lines(), loc='outside lower center', ncols=4)
        elif left.lines:
            left.legend(loc='best')
        if right is not None:
            right.set_yticks(range(len(shown)), [name[:28] for name in shown])
            right.set_ylim(len(shown) - 0.5, -0.5)
            right.set_xlabel(score)
    return figure


def _shown(arms: Mapping[str, Sequence[Outcome]]) -> Mapping[str, Sequence[Outcome]]:
    """Return the arms to draw, in their order: those that have anything to show."""
    arms = {name: outcomes for name, outcomes in arms.items()
            if any(len(outcome.curve.places) for outcome in outcomes)}
    if len(arms) <= MOST_ARMS:
        return arms

    def worth(name: str) -> float:
        scores = scores_of(arms[name])
        return interquartile_mean(scores) if scores.size else -np.inf

    best = set(sorted(arms, key=worth, reverse=True)[:MOST_ARMS])
    return {name: outcomes for name, outcomes in arms.items() if name in best}


def _curve(axes: Axes, name: str, outcomes: Sequence[Outcome], colour: str, dash: object) -> None:
    curves = [outcome.curve for outcome in outcomes if len(outcome.curve.places)]
    if not curves:
        return
    places, mean, lowest, highest = band(curves)
    axes.plot(places, mean, color=colour, linestyle=dash, label=f'{name[:40]} ({len(curves)})')
    axes.fill_between(places, lowest, highest, color=colour, alpha=0.15, linewidth=0)


def _scores(axes: Axes, number: int, outcomes: Sequence[Outcome], colour: str) -> None:
    scores = scores_of(outcomes)
    if not scores.size:
        return
    found = estimate(scores, interquartile_mean)
    if found.low is not None:
        axes.plot([found.low, found.high], [number, number], color=colour, linewidth=6, alpha=0.3,
                  solid_capstyle='butt')
    axes.plot(scores.mean(axis=1), np.full(len(scores), number), 'o', color=colour, markersize=4,
              markerfacecolor='white')
    axes.plot(found.value, number, '|', color=colour, markersize=16, markeredgewidth=2.5)
