# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The figures of the report: 1 to 6 as in the seed document, then what it did not show.

Every function takes the runs to lay over each other, the first of them the one reported on, and
a size in inches. It raises `NothingToShow` when no run has the records for it.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses

from carracing_dqn.evaluation import figure_style as style
from carracing_dqn.evaluation.comparison import smoothing_window
from carracing_dqn.evaluation.records import Run
from carracing_dqn.evaluation.results import Results
from carracing_dqn.evaluation.seed_document import SHORT_NAME, STATED
from carracing_dqn.evaluation.statistics import (
    moving_average, percent, share_interval, THRESHOLDS,
)
from carracing_dqn.evaluation.tables import Table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
import numpy as np

Size = tuple[float, float]
BIN = 25.0
"""Points in a bar of the distribution, in CarRacing."""
BINS = 40
"""Bars of it elsewhere, and where returns are none of CarRacing."""
MOST_WIDTH = 10 * BIN
STATED_MEANS = (('test_mean', 'trained'), ('dummy_mean', 'dummy'))

LAP_WINDOW = 10
ROOM_FOR_TEXT = 110.0
"""Points below the lowest line, for its name."""

# inches that a legend entry takes: its sign with the gaps, and each letter
LEGEND_HANDLE, LEGEND_LETTER = 0.7, 0.07


class NothingToShow(Exception):
    """No run has the records for a figure; the text says which."""


@dataclasses.dataclass(frozen=True)
class FigureKind:
    """
    A figure of the report.

    Attributes:
        name: file name without suffix.
        title: heading above it.
        caption: what is seen.
        draw: makes it.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Sequence[Run], Size], Figure]


def draw(kind: FigureKind, runs: Sequence[Run], size: Size = style.WIDE) -> Figure:
    """Draw a figure in our style; raises NothingToShow."""
    with style.styled():
        return kind.draw(runs, size)


# Training. -------------------------------------------------------------------------------------

def _training_rewards(runs: Sequence[Run], size: Size) -> Figure:
    figure, axes = _one(size, 'training episode', 'return, points')
    drawn = [run for run in runs if run.episodes.has('train_reward')]
    _need(drawn, 'no run has training episodes (episodes.csv, train_reward)')
    for run, colour, dash in _styled_runs(runs, drawn):
        numbers, rewards = _against(run.episodes, 'episode', 'train_reward')
        window = smoothing_window(len(rewards))
        axes.plot(numbers, rewards, '.', markersize=3, color=colour, alpha=0.3, rasterized=True)
        axes.plot(numbers, moving_average(rewards, window), color=colour, linestyle=dash,
                  label=f'{style.label(run.name)}, mean of {window}')
    if runs[0].in_carracing:
        axes.plot(
            [0, STATED['train_average_zero'], STATED['train_average_800'], STATED['episodes']],
            [STATED['train_first'], 0, 800, STATED['train_average_last']], linestyle='none',
            marker='D', markersize=5, markerfacecolor='white', color=style.SEED_COLOUR,
            label=f'{SHORT_NAME}, stated points of its mean')
    _legend_below(figure, axes)
    return figure


def _validation_rewards(runs: Sequence[Run], size: Size) -> Figure:
    figure, axes = _one(size, 'training episode', 'mean return, points')
    drawn = [run for run in runs if run.validation.has('mean', 'episode')
             or run.episodes.has('validation_reward', 'episode')]
    _need(drawn, 'no run has validations (validation.csv, mean; or episodes.csv, '
          'validation_reward)')
    for run, colour, dash in _styled_runs(runs, drawn):
        table, column = run.validation, 'mean'
        if not table.has('mean', 'episode'):
            table, column = run.episodes, 'validation_reward'
        episodes, means = table.known('episode', column)
        if table.has('std'):
            episodes, means, spread = table.known('episode', column, 'std')
            axes.fill_between(episodes, means - spread, means + spread, color=colour, alpha=0.15,
                              linewidth=0)
        axes.plot(episodes, means, 'o', markersize=4, linestyle=dash, color=colour,
                  label=style.label(run.name))
    if runs[0].in_carracing:
        axes.plot(
            [0, 700, STATED['validation_maximum_episode'], STATED['episodes']],
            [STATED['validation_first'], STATED['validation_700'], STATED['validation_maximum'],
             STATED['validation_last']], linestyle='none', marker='D', markersize=5,
            markerfacecolor='white', color=style.SEED_COLOUR,
            label=f'{SHORT_NAME}, stated points')
    _legend_below(figure, axes)
    return figure


def _schedules(runs: Sequence[Run], size: Size) -> Figure:
    drawn = [run for run in runs
             if run.episodes.has('epsilon') or run.episodes.has('learning_rate')]
    _need(drawn, 'no run has epsilon or learning rate (episodes.csv)')
    figure, (upper, lower) = _two(size, 'training episode', 'epsilon', 'learning rate')
    for run, colour, dash in _styled_runs(runs, drawn):
        for axes, column in ((upper, 'epsilon'), (lower, 'learning_rate')):
            if run.episodes.has(column):
                axes.plot(*_against(run.episodes, 'episode', column), color=colour,
                          linestyle=dash, label=style.label(run.name))
    upper.set_ylim(bottom=0)
    lower.set_yscale('log')
    _legend_below(figure, upper)
    return figure


def _losses(runs: Sequence[Run], size: Size) -> Figure:
    drawn = [run for run in runs if run.updates.has('loss') or run.updates.has('q_mean')
             or run.episodes.has('loss') or run.episodes.has('q_mean')]
    _need(drawn, 'no run has losses or Q-values (updates.csv)')
    figure, (upper, lower) = _two(size, 'update', 'loss', 'mean Q-value')
    for run, colour, dash in _styled_runs(runs, drawn):
        for axes, column in ((upper, 'loss'), (lower, 'q_mean')):
            table = run.updates if run.updates.has(column) else run.episodes
            if table.has(column):
                axes.plot(*_against(table, 'updates', column), color=colour, linestyle=dash,
                          linewidth=1.2, label=style.label(run.name))
    if all((line.get_ydata() > 0).all() for line in upper.lines) and upper.lines:
        upper.set_yscale('log')
    _legend_below(figure, upper if upper.lines else lower)
    return figure


def _wall_time(runs: Sequence[Run], size: Size) -> Figure:
    drawn = [run for run in runs if run.episodes.has('wall_seconds', 'train_reward')
             or run.validation.has('wall_seconds', 'mean')]
    _need(drawn, 'no run has wall times (wall_seconds)')
    figure, axes = _one(size, 'wall time, minutes', 'return, points')
    for run, colour, dash in _styled_runs(runs, drawn):
        if run.episodes.has('wall_seconds', 'train_reward'):
            seconds, rewards = run.episodes.known('wall_seconds', 'train_reward')
            axes.plot(seconds / 60, moving_average(rewards, smoothing_window(len(rewards))),
                      color=colour, alpha=0.55, linestyle=dash, linewidth=1.3,
                      label=f'{style.label(run.name)}, training '
                            f'(mean of {smoothing_window(len(rewards))})')
        if run.validation.has('wall_seconds', 'mean'):
            seconds, means = run.validation.known('wall_seconds', 'mean')
            axes.plot(seconds / 60, means, 'o', markersize=4.5, linestyle='-', color=colour,
                      label=f'{style.label(run.name)}, validation')
    if runs[0].in_carracing:
        axes.axhline(
            STATED['test_mean'], color=style.SEED_COLOUR, linewidth=1, linestyle=(0, (4, 3)),
            label=f'{SHORT_NAME}: {STATED["test_mean"]:g} after {STATED["hours"]:g} h on a GPU')
    _legend_below(figure, axes)
    return figure


# Test laps. ------------------------------------------------------------------------------------

def _dummy_against_trained(runs: Sequence[Run], size: Size) -> Figure:
    figure, axes = _one(size, 'test lap', 'return, points')
    for name, results, colour, dash in _agents(runs):
        returns = np.array([lap.episode_return for lap in results.ordered])
        numbers = np.arange(1, len(returns) + 1)
        axes.plot(numbers, returns, '.', markersize=4, color=colour, alpha=0.4)
        axes.plot(numbers, moving_average(returns, LAP_WINDOW), color=colour, linestyle=dash,
                  label=f'{name}, mean of {LAP_WINDOW}')
    if runs[0].in_carracing:
        style.horizontal_mark(axes, STATED['test_mean'], f'{SHORT_NAME}, trained')
        style.horizontal_mark(axes, STATED['dummy_mean'], f'{SHORT_NAME}, dummy')
        axes.set_ylim(bottom=min(axes.get_ylim()[0], STATED['dummy_mean'] - ROOM_FOR_TEXT))
    _legend_below(figure, axes)
    return figure


def _distribution(runs: Sequence[Run], size: Size) -> Figure:
    figure, axes = _one(size, 'return, points', 'share of the laps')
    agents = _agents(runs)
    everything = [lap.episode_return for _, results, _, _ in agents for lap in results.ordered]
    width = max(np.ptp(everything) / BINS, 1e-6 * max(1.0, *map(abs, everything)))
    if runs[0].in_carracing and width < MOST_WIDTH:
        # as suits its thousand points
        width = BIN
    low = np.floor(min(everything) / width) * width
    high = np.ceil(max(everything) / width) * width + width
    bins = np.arange(low, high + width / 2, width)
    for name, results, colour, dash in agents:
        returns = np.array([lap.episode_return for lap in results.ordered])
        weights = np.full(len(returns), 1 / len(returns))
        axes.hist(returns, bins, weights=weights, color=colour, alpha=0.35, label=name)
        axes.hist(returns, bins, weights=weights, color=colour, histtype='step', linestyle=dash,
                  linewidth=1.4)
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axes.set_ylim(top=1.25 * axes.get_ylim()[1])
    for key, who in STATED_MEANS if runs[0].in_carracing else ():
        axes.axvline(STATED[key], color=style.SEED_COLOUR, linewidth=1, linestyle=(0, (4, 3)))
        axes.annotate(f'{SHORT_NAME},\n{who}: {STATED[key]:g}', (STATED[key], 0.98),
                      xycoords=('data', 'axes fraction'), xytext=(4 if who == 'dummy' else -4, 0),
                      textcoords='offset points', fontsize=8.5, color=style.SEED_COLOUR,
                      va='top', ha='left' if who == 'dummy' else 'right')
    _legend_below(figure, axes)
    return figure


def _completion(runs: Sequence[Run], size: Size) -> Figure:
    agents = _agents(runs)
    figure, axes = _one(size, 'laps with all tiles visited, of all laps', '')
    names, shares, colours, errors = [], [], [], []
    if runs[0].in_carracing:
        names += [f'{SHORT_NAME}, dummy', f'{SHORT_NAME}, trained']
        shares += [STATED['dummy_completed'] / 100, STATED['test_completed'] / 100]
        colours += [style.PALE, style.SEED_COLOUR]
        errors += [(0.0, 0.0), (0.0, 0.0)]
    for name, results, colour, _ in agents:
        laps = [lap.lap_finished for lap in results.ordered]
        if None in laps:
            continue
        finished = sum(laps)
        share = finished / len(results.laps)
        low, high = share_interval(finished, len(results.laps))
        names.append(name)
        shares.append(share)
        colours.append(colour)
        errors.append((max(0.0, share - low), max(0.0, high - share)))
    _need(names, 'its simulator says nothing of laps')
    places = np.arange(len(names))[::-1]
    axes.barh(places, shares, color=colours, height=0.62)
    axes.errorbar(shares, places, xerr=np.array(errors).T, fmt='none', ecolor=style.INK,
                  elinewidth=1.2, capsize=3)
    for place, share, (_, above) in zip(places, shares, errors):
        axes.annotate(percent(share), (share + above, place), xytext=(6, 0),
                      textcoords='offset points', va='center', fontweight='bold')
    axes.set_yticks(places, names)
    axes.set_xlim(0, 1.12)
    axes.set_xticks(np.arange(0, 1.01, 0.2))
    axes.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axes.grid(visible=False, axis='y')
    return figure


def _success(runs: Sequence[Run], size: Size) -> Figure:
    agents = _agents(runs)
    _need(runs[0].in_carracing, "these thresholds are CarRacing's")
    figure, axes = _one(size, 'return of at least', 'share of the laps')
    width = 0.8 / len(agents)
    for place, (name, results, colour, _) in enumerate(agents):
        returns = np.array([lap.episode_return for lap in results.ordered])
        for number, threshold in enumerate(THRESHOLDS):
            reached = int((returns >= threshold).sum())
            share = reached / len(returns)
            low, high = share_interval(reached, len(returns))
            x = number + (place - (len(agents) - 1) / 2) * width
            axes.bar(x, share, 0.9 * width, color=colour, label=name if number == 0 else None)
            axes.errorbar(x, share, yerr=[[max(0, share - low)], [max(0, high - share)]],
                          ecolor=style.INK, elinewidth=1.2, capsize=3)
            axes.annotate(percent(share), (x, high), xytext=(0, 3), textcoords='offset points',
                          ha='center', fontsize=9)
    axes.set_xticks(range(len(THRESHOLDS)), [f'{threshold} points' for threshold in THRESHOLDS])
    axes.set_ylim(0, 1.15)
    axes.set_yticks(np.arange(0, 1.01, 0.2))
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axes.grid(visible=False, axis='x')
    _legend_below(figure, axes)
    return figure


def _agents(runs: Sequence[Run]) -> list[tuple[str, Results, str, object]]:
    """Return name, laps, colour and dash of the dummy agent and of every run that has laps."""
    agents = []
    dummy = next((run.dummy for run in runs if run.dummy is not None), None)
    if dummy is not None:
        agents.append(('dummy agent', dummy, style.DUMMY_COLOUR, ':'))
    drawn = [run for run in runs if run.evaluation is not None]
    agents += [(style.label(run.name), run.evaluation, colour, dash)
               for run, colour, dash in _styled_runs(runs, drawn)]
    _need(agents, 'no run has test laps (evaluation.json of carracing evaluate)')
    return agents


# Helpers. --------------------------------------------------------------------------------------

def _need(found: object, reason: str) -> None:
    if not found:
        raise NothingToShow(reason)


def _styled_runs(runs: Sequence[Run], drawn: Sequence[Run]) -> list[tuple[Run, str, object]]:
    """Return the runs to draw, each with the colour and dash it has in every figure."""
    colours = [colour for colour in style.RUN_COLOURS if colour != style.DUMMY_COLOUR]
    return [(run, colours[place % len(colours)], style.RUN_DASHES[place % len(style.RUN_DASHES)])
            for place, run in enumerate(runs) if run in drawn]


def _against(table: Table, x: str, y: str) -> list[np.ndarray]:
    """Return x and y where both are known; the row number where there is no x."""
    if table.has(x):
        return table.known(x, y)
    values, = table.known(y)
    return [np.arange(len(values), dtype=float), values]


def _one(size: Size, x: str, y: str) -> tuple[Figure, Axes]:
    figure = style.new_figure(size)
    axes = figure.subplots()
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    return figure, axes


def _two(size: Size, x: str, upper: str, lower: str) -> tuple[Figure, tuple[Axes, Axes]]:
    """Return a figure with two axes, beside each other or, when it is narrow, stacked."""
    narrow = size[0] < 6
    figure = style.new_figure((size[0], size[1] * 1.4) if narrow else size)
    first, second = figure.subplots(*((2, 1) if narrow else (1, 2)))
    for axes, label in ((first, upper), (second, lower)):
        axes.set_title(label)
        axes.set_xlabel(x)
    return figure, (first, second)


def _legend_below(figure: Figure, axes: Axes) -> None:
    """Put the legend below, in as many columns as the width holds."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        inches = LEGEND_HANDLE + LEGEND_LETTER * max(map(len, labels))
        columns = int(np.clip(figure.get_figwidth() // inches, 1, len(handles)))
        figure.legend(handles, labels, loc='outside lower center', ncols=columns)



FIGURES = (
    FigureKind('figure_1_training_rewards', 'Figure 1: Training rewards over time',
               'Every dot is a training episode, exploration included; the line is the moving '
               'average.', _training_rewards),
    FigureKind('figure_2_validation_rewards', 'Figure 2: Validation rewards over time',
               'Greedy laps on tracks that training does not see; the band is one standard '
               'deviation over the laps of a validation.', _validation_rewards),
    FigureKind('figure_3_dummy_against_trained', 'Figure 3: Dummy agent against trained agent',
               'Greedy test laps, each on a track of its own, in the unmodified environment '
               'unless noted; dots are laps, lines the mean of ten.', _dummy_against_trained),
    FigureKind('figure_4_reward_distribution', 'Figure 4: Reward distribution',
               f'Share of the test laps in bars of {BIN:g} points.', _distribution),
    FigureKind('figure_5_completion_rate', 'Figure 5: Completion rate',
               'Share of the test laps in which every tile was visited; whiskers: 95 % '
               'confidence (Wilson).', _completion),
    FigureKind('figure_6_success', 'Figure 6: Success at reward thresholds',
               'Share of the test laps that reach a return; whiskers: 95 % confidence (Wilson). '
               'The document gives words only.', _success),
    FigureKind('figure_7_epsilon_and_learning_rate', 'Figure 7: Epsilon and learning rate',
               'Share of random actions, and step size of the optimizer.', _schedules),
    FigureKind('figure_8_losses_and_q_values', 'Figure 8: Losses and Q-values',
               'Means over some hundred updates. Rewards, and with them Q-values, may be scaled '
               '(see reward_scale in the settings).', _losses),
    FigureKind('figure_9_wall_time', 'Figure 9: What the time bought',
               'Returns against the wall clock, validation included in the time.', _wall_time),
)
