# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a study: Markdown, a figure and the figures as JSON, small enough to commit."""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from carracing_dqn.evaluation.figure_style import image_bytes
from carracing_dqn.evaluation.statistics import percent
from carracing_dqn.studies.bootstrap import (
    Estimate, estimate, improvement, interquartile_mean, permutation_p,
)
from carracing_dqn.studies.curves import band, draw
from carracing_dqn.studies.errors import StudyError
from carracing_dqn.studies.outcome import DONE, LAST_EPISODES, Outcome, scores_of
from carracing_dqn.studies.study_file import Arm, FINAL, Study, study_names
from msgs_bridge.atomic_write import write_bytes, write_text
from msgs_bridge.machine import describe_machine
import numpy as np

FORMAT = 'carracing_dqn study 1'
MIDDLE = 0.5
"""Probability of improvement of what makes no difference."""

SIGNIFICANT = 0.05
# less is not shown as a number, which would be 0.00
LEAST_P = 0.01
RUN_FIGURES = {
    'decisions': '.0f', 'episodes': '.0f', 'updates': '.0f', 'q_mean': '.2f', 'minutes': '.0f'}
SETTINGS_SHOWN = 12


def write_page(
    study: Study, arms: Sequence[Arm], outcomes: Sequence[Outcome], folder: Path,
    notes: Iterable[str] = (),
) -> Path:
    """
    Write NAME.md, NAME.png and NAME.json into a folder; return the first.

    Args:
        study: what was asked.
        arms: those that were planned.
        outcomes: of all their runs.
        folder: made if it is not there.
        notes: sentences for the top of the page.

    Raises:
        StudyError: they cannot be written.
    """
    by_arm = {arm.name: [outcome for outcome in outcomes if outcome.run.arm == arm.name]
              for arm in arms}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / f'{study.name}.json', json.dumps(
            _record(study, by_arm), separators=(',', ':')) + '\n')
        figure = draw(by_arm, study.settings.curve, _score(study))
        write_bytes(folder / f'{study.name}.png', image_bytes(figure, 'png'))
        path = folder / f'{study.name}.md'
        # what a study says of itself may hold halves of signs, which no file can
        write_bytes(path, _markdown(study, arms, by_arm, list(notes)).encode('utf-8', 'replace'))
    except OSError as error:
        raise StudyError(f'{error.filename or folder}: {error.strerror}') from None
    return path


def _file(study: Study) -> str:
    return study.name if study.name in study_names() else f'{study.name}.yaml'


def _score(study: Study) -> str:
    if study.settings.laps:
        return 'return of test laps'
    return f'training return, last {LAST_EPISODES}'


def _markdown(
    study: Study, arms: Sequence[Arm], by_arm: Mapping[str, Sequence[Outcome]], notes: list[str],
) -> str:
    runs = [outcome for outcomes in by_arm.values() for outcome in outcomes]
    done = sum(outcome.state == DONE for outcome in runs)
    lines = [f'# Study {study.name}', '']
    if study.settings.about:
        lines += [study.settings.about.strip(), '']
    lines += [f'{done} of {len(runs)} runs are done. `carracing study {_file(study)}` drives what '
              'is left and writes this page.', '']
    lines += [f'- {note}' for note in (*study.notes, *notes)]
    baseline = study.baseline or next(iter(by_arm), '')
    lines += ['', f'![Curves and scores]({study.name}.png)', '', _reading(study, baseline), '']
    lines += _result_table(baseline, by_arm)
    lines += ['', '## Arms', '', '| arm | what it is | settings of its own |', '|---|---|---|']
    lines += [f'| {arm.name} | {_cell(arm.about)} | {_cell(_settings_of(arm))} |'
              for arm in arms]
    if study.set:
        lines += ['', f'All of them: {_pairs(study.set)}.']
    lines += ['', '## Runs', '', *_run_table(runs), '']
    return '\n'.join(lines)


def _reading(study: Study, baseline: str) -> str:
    settings = study.settings
    by = (f'{settings.laps} test laps of its {"last" if settings.model == FINAL else "best"} '
          f'weights, greedy, from seed {settings.test_seed}' if settings.laps else
          f"the mean of its last {LAST_EPISODES} training episodes, in the environment's own "
          'reward')
    return (
        f'Each run is judged by {by}. Curves: mean over the seeds, the band from the lowest to '
        'the highest, as far as the shortest run goes. IQM is the mean of the middle half of all '
        f'laps, P the probability that a run does better than one of `{baseline}` on the '
        'same track (arXiv 2108.13264); brackets are 95 % bootstrap intervals over whole runs. '
        'p is that of an exact permutation test of the means of runs; three seeds against three '
        'cannot get below 0.10. Spread is the standard deviation between seeds (n - 1). Circles '
        'are seeds.')


def _result_table(baseline: str, by_arm: Mapping[str, Sequence[Outcome]]) -> list[str]:
    lines = [
        '| arm | seeds | mean | spread | IQM | finished | stands at the end | training, last '
        f'{LAST_EPISODES} | P(better than {baseline}) | '
        'p of the means |',
        '|---|---|---|---|---|---|---|---|---|---|']
    base = scores_of(by_arm.get(baseline, ()))
    for name, outcomes in by_arm.items():
        done = [outcome for outcome in outcomes if outcome.state == DONE]
        seeds = f'{len(done)} of {len(outcomes)}' if len(done) < len(outcomes) else f'{len(done)}'
        if not done:
            lines.append(f'| {name} | {seeds} | | | | | | | | |')
            continue
        scores = scores_of(done)
        means = scores.mean(axis=1)
        last = [outcome.training[-LAST_EPISODES:].mean() for outcome in done
                if len(outcome.training)]
        better = ' | ' if name == baseline or not base.size else _verdict(scores, base)
        lines.append(
            f'| {name} | {seeds} | {means.mean():.1f} | {_spread(means)} | '
            f'{_bracketed(estimate(scores, interquartile_mean), ".1f")} | '
            f'{_share(done, "completed")} | {_share(done, "stopped")} | '
            f'{np.mean(last) if last else float("nan"):.1f} | {better} |')
    return lines


def _verdict(scores: np.ndarray, base: np.ndarray) -> str:
    """Return two cells: probability of improvement, and p with what it comes to in a word."""
    found, p = improvement(scores, base), permutation_p(scores, base)
    if found.low is None:
        word = 'one seed'
    elif found.low <= MIDDLE <= found.high:
        word = 'not told apart'
    else:
        word = 'better' if found.low > MIDDLE else 'worse'
        word = f'**{word}**' if p <= SIGNIFICANT else f'{word} here'
    shown = f'{p:.2f}' if p >= LEAST_P else f'below {LEAST_P:g}'
    return f'{_bracketed(found, ".2f")} | {shown}, {word}'


def _bracketed(found: Estimate, form: str) -> str:
    text = format(found.value, form)
    if found.low is None:
        return text
    return f'{text} [{format(found.low, form)}, {format(found.high, form)}]'


def _spread(means: np.ndarray) -> str:
    return f'{means.std(ddof=1):.1f}' if len(means) > 1 else ''


def _share(outcomes: Sequence[Outcome], name: str) -> str:
    shares = [getattr(outcome.statistics, name) for outcome in outcomes if outcome.laps]
    if not shares or None in shares:
        return ''
    return percent(float(np.mean(shares))).replace('%', ' %')


def _settings_of(arm: Arm) -> str:
    texts = [f'preset `{arm.preset}`'] if arm.preset else []
    texts += [f'simulator `{arm.simulator}`'] if arm.simulator else []
    return ', '.join([*texts, *([_pairs(arm.set)] if arm.set else [])])


def _pairs(values: Mapping[str, Any]) -> str:
    shown = [f'`{name}={str(value).lower() if isinstance(value, bool) else value}`'
             for name, value in values.items()]
    more = len(shown) - SETTINGS_SHOWN
    return ', '.join([*shown[:SETTINGS_SHOWN], *([f'and {more} more'] if more > 0 else [])])


def _run_table(runs: Sequence[Outcome]) -> list[str]:
    lines = ['| run | state | mean | decisions | episodes | updates | mean Q at the end | minutes '
             '| folder |', '|---|---|---|---|---|---|---|---|---|']
    for outcome in runs:
        figures = [format(outcome.figures[name], digits) if name in outcome.figures else ''
                   for name, digits in RUN_FIGURES.items()]
        state = outcome.state + (f': {outcome.problem}' if outcome.problem else '')
        mean = f'{outcome.scores.mean():.1f}' if outcome.state == DONE else ''
        lines.append(f'| {outcome.run.name} | {_cell(state)} | {mean} | {" | ".join(figures)} | '
                     f'`{_shown_folder(outcome.run.folder)}` |')
    return lines


def _cell(text: str) -> str:
    return text.replace('|', '/').replace('\n', ' ')


def _shown_folder(folder: Path) -> str:
    """Return a folder as a page may name it: from here, and never by whose home it is in."""
    relative = os.path.relpath(folder)
    return '/'.join(folder.parts[-3:]) if relative.startswith('..') else relative


def _record(study: Study, by_arm: Mapping[str, Sequence[Outcome]]) -> dict[str, Any]:
    """Return everything the page shows as JSON values."""
    machine = describe_machine()
    machine.pop('load_average', None)
    return {
        'format': FORMAT, 'study': study.name, 'settings': dataclasses.asdict(study.settings),
        'set': dict(study.set), 'machine': machine,
        'arms': {name: _arm_record(outcomes) for name, outcomes in by_arm.items()}}


def _arm_record(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    curves = [outcome.curve for outcome in outcomes if len(outcome.curve.places)]
    shown = band(curves) if curves else ()
    return {
        'curve': {name: [round(float(value), 1) for value in values]
                  for name, values in zip(('places', 'mean', 'lowest', 'highest'), shown)},
        'runs': [{
            'seed': outcome.run.seed, 'folder': _shown_folder(outcome.run.folder),
            'state': outcome.state, 'problem': outcome.problem, 'figures': outcome.figures,
            'statistics': outcome.statistics and outcome.statistics.to_json(),
            'scores': [round(float(value), 2) for value in outcome.scores]
            if outcome.state == DONE else []} for outcome in outcomes]}
