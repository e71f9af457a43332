# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`report.html`: one self-contained page, for a screen, a phone and paper."""
from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Sequence
import dataclasses
import importlib.resources
from typing import Any

from carracing_dqn.evaluation import figure_style as style
from carracing_dqn.evaluation import seed_document
from carracing_dqn.evaluation.comparison import compare, judge, Measured, Verdict
from carracing_dqn.evaluation.figures import draw, FigureKind, FIGURES, NothingToShow
from carracing_dqn.evaluation.lap_picture import lap_picture, lap_title
from carracing_dqn.evaluation.progress import summary_rows
from carracing_dqn.evaluation.records import Run
from carracing_dqn.evaluation.trajectory import Trajectory
import jinja2
from matplotlib.figure import Figure
from msgs_bridge.plain_text import plain

TEMPLATE = 'report.html.j2'
# what the first card of the page says: the first of these that was measured
HOW_GOOD = (('test_mean', 'mean return'), ('validation_maximum', 'best validation'),
            ('train_average_last', 'training, moving average at the end'))
# what so many rows of a table would say is said once below it
SAID_ONCE = 3
# characters of a cell of Markdown, which is one line
CELL = 1000


@dataclasses.dataclass(frozen=True)
class Picture:
    """
    A figure as the page shows it.

    Attributes:
        name: file name without suffix.
        title, caption: texts around it.
        wide, narrow: data URIs for a page and for a phone; empty when there is nothing to show.
        reason: why there is nothing to show.
        figure: the wide one, to be saved.
    """

    name: str
    title: str
    caption: str
    wide: str = ''
    narrow: str = ''
    reason: str = ''
    figure: Figure | None = None


def make_pictures(runs: Sequence[Run]) -> list[Picture]:
    """Draw every figure of the report over the runs; what cannot be shown says why."""
    return [_picture(kind, runs) for kind in FIGURES]


def lap_pictures(laps: Sequence[tuple[str, Trajectory]]) -> list[Picture]:
    """Draw laps from above, each with its heading."""
    return [
        Picture(
            f'lap_{trajectory.lap.seed}', heading, lap_title(trajectory.lap),
            _data_uri(wide := lap_picture(trajectory)),
            _data_uri(lap_picture(trajectory, phone=True)), figure=wide)
        for heading, trajectory in laps]


def render(runs: Sequence[Run], pictures: Sequence[Picture], laps: Sequence[Picture]) -> str:
    """
    Return the page.

    Args:
        runs: the run reported on, then those it is laid beside.
        pictures: the figures.
        laps: laps seen from above.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(
        importlib.resources.files('carracing_dqn.evaluation').joinpath(TEMPLATE).read_text(encoding='utf-8'))
    return template.render(
        runs=runs, document=seed_document,
        groups=[(group, rows, _often(rows)) for group, rows in comparison_groups(runs)],
        verdicts=[judge(run) for run in runs], headlines=headlines(runs[0]),
        statistics=[(run.name, summary_rows(run.evaluation.statistics))
                    for run in runs if run.evaluation is not None],
        facts=[(run, run_facts(run)) for run in runs], pictures=pictures, laps=laps)


def comparison_groups(
    runs: Sequence[Run],
) -> list[tuple[str, list[tuple[seed_document.Figure, list[Measured]]]]]:
    """Return the table: group -> rows of a stated figure and that of every run."""
    groups: dict[str, list[Any]] = {}
    columns = [compare(run) for run in runs]
    for row in zip(*columns):
        figure = row[0][0]
        groups.setdefault(figure.group, []).append((figure, [measured for _, measured in row]))
    return list(groups.items())


def _often(rows: Sequence[tuple[seed_document.Figure, list[Measured]]]) -> list[str]:
    """Return why nothing was measured, where several rows of a group say the same of it."""
    reasons = Counter(
        value.text for _, measured in rows for value in measured if value.value is None)
    return [text for text, count in reasons.items() if count >= SAID_ONCE and text[0] == '–']


def headlines(run: Run) -> list[tuple[str, str, str]]:
    """Return number, label and the document's number, for the top of the page."""
    stated = {figure.key: figure for figure in seed_document.FIGURES}
    measured = {figure.key: value for figure, value in compare(run)}
    rows: list[tuple[str, str, str]] = []
    for key, label in () if not run.in_carracing else (
        next((pair for pair in HOW_GOOD if measured[pair[0]].value is not None), HOW_GOOD[0]),
        ('test_completed', 'laps finished'),
        ('test_900', 'laps of 900 or more'), ('hours', 'training time'),
    ):
        if measured[key].value is None:
            continue
        text = measured[key].text
        if key == 'test_mean':
            text += f' ± {measured["test_std"].text}'
        rows.append((text, label, stated[key].stated + (
            f' ± {stated["test_std"].stated}' if key == 'test_mean' else '')))
    return rows


def run_facts(run: Run) -> list[tuple[str, str]]:
    """Return what is known of how a run was made."""
    facts: list[tuple[str, str]] = []
    sessions = run.record.get('sessions')
    session = sessions[-1] if isinstance(sessions, list) and sessions else {}
    if not isinstance(session, dict):
        session = {}
    for label, value in (
        ('started', run.record.get('started')), ('code', session.get('code')),
        ('processor', session.get('processor')), ('cores', session.get('cores')),
        ('device', session.get('device')), ('system', session.get('system')),
    ):
        if value not in (None, ''):
            facts.append((label, str(value)))
    if run.wall_seconds is not None:
        facts.append(('training time', f'{run.wall_seconds / 60:.1f} min'))
    for label, results in (('test laps', run.evaluation), ('dummy laps', run.dummy)):
        if results is not None:
            seeds = sorted(results.laps)
            simulator = {
                'gymnasium': "unmodified gymnasium.make('CarRacing-v3')",
                'fast': 'the fast simulator, equal to gymnasium to the byte',
                'graph': 'over the ROS graph',
            }.get(results.simulator, results.simulator)
            facts.append((label, f'{len(seeds)} tracks, seeds {seeds[0]} to {seeds[-1]}, '
                          f'in {simulator}'))
    return facts


def markdown(runs: Sequence[Run], verdicts: Sequence[Sequence[Verdict]]) -> str:
    """Return the objectives and the table against the document as Markdown."""
    names = ' | '.join(_cell(run.name) for run in runs)
    lines = [f'| objective (1.2) | {names} |', '|---|' + '---|' * len(runs)]
    for row in zip(*verdicts):
        cells = ' | '.join(f'**{verdict.word}**: {_cell(verdict.text)}' for verdict in row)
        lines.append(f'| {_cell(row[0].objective.text)} | {cells} |')
    for group, rows in comparison_groups(runs):
        lines += ['', f'| {group} | section | {seed_document.SHORT_NAME} | {names} |',
                  '|---|---|---|' + '---|' * len(runs)]
        for figure, measured in rows:
            cells = ' | '.join(_cell(value.text) for value in measured)
            lines.append(f'| {_cell(figure.label)} | {figure.section} | {_cell(figure.stated)} | '
                         f'{cells} |')
    return '\n'.join(lines) + '\n'


def _cell(text: str) -> str:
    return plain(text, CELL).replace('|', '\\|')


def _picture(kind: FigureKind, runs: Sequence[Run]) -> Picture:
    try:
        wide = draw(kind, runs, style.WIDE)
        narrow = draw(kind, runs, style.NARROW)
    except NothingToShow as reason:
        return Picture(kind.name, kind.title, kind.caption, reason=str(reason))
    picture = Picture(kind.name, kind.title, kind.caption, _data_uri(wide), _data_uri(narrow),
                      figure=wide)
    # the page has headings of its own; a file stands alone
    with style.styled():
        wide.suptitle(kind.title, x=0.01, ha='left', fontsize=12, fontweight='bold')
    return picture


def _data_uri(figure: Figure) -> str:
    """Return a figure as an SVG that a page can carry inside."""
    data = base64.b64encode(style.image_bytes(figure, 'svg')).decode()
    return f'data:image/svg+xml;base64,{data}'
