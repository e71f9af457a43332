# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How learning looks while it goes on: tables of 80 columns, or a line."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
import math
from pathlib import Path

from carracing_dqn.bringup.graph import POLICY, SIMULATOR, TRAINER
from carracing_dqn.bringup.cars_display import cars_in_words, cars_table
from carracing_dqn.bringup.monitor import GraphState
from msgs_bridge.errors import BridgeError
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

LIVE_VALUES = (
    ('return, last episode', 'last_return', '.1f'),
    ('return, moving average', 'mean_return', '.1f'),
    ('episodes', 'episodes', '.0f'),
    ('decisions', 'decisions', '.0f'),
    ('updates', 'updates', '.0f'),
    ('epsilon', 'epsilon', '.3f'),
    ('learning rate', 'learning_rate', '.2e'),
    ('updates/s', 'updates_per_second', '.1f'),
    ('samples per transition', 'replay_ratio', '.2f'),
    ('replay', 'replay_size', '.0f'),
    ('TD error', 'td_error', '.3f'),
    ('mean Q', 'q_mean', '.2f'),
    ('weights version', 'weights_version', '.0f'),
    ('share of the run done', 'progress', '.1%'),
)
"""Label, name in the trainer's diagnostics and format of what the display shows."""

SHOWN_VALIDATIONS = 3

FRAME = 4
"""Lines of a table that are no rows: title, frame, prompt."""


def training_table(state: GraphState, rows: int) -> RenderableType:
    """Return the state of learning as tables of 80 columns and fewer than `rows` lines."""
    table = Table(title=Text(state.summary(TRAINER.name)), show_header=False, padding=(0, 1))
    for _ in range(2):
        table.add_column()
        table.add_column(justify='right')
    entries = list(_entries(state))
    half = (len(entries) + 1) // 2
    for left, right in zip(entries[:half], [*entries[half:], ('', '')]):
        table.add_row(*left, *right)
    validations = [
        f'{result["version"]:.0f}: {result["mean"]:.1f} ± {result["std"]:.1f}, '
        f'{result["completed"]:.0%} completed'
        for result in list(state.validations)[-SHOWN_VALIDATIONS:]]
    if validations:
        table.caption = 'validation of version ' + '\n'.join(validations)
    if not state.cars:
        return table
    used = table.row_count + len(validations) + FRAME
    return Group(table, cars_table(state, rows - used))


def _entries(state: GraphState) -> Iterator[tuple[str, str]]:
    """Yield label and text of every value."""
    for label, name, form in LIVE_VALUES:
        yield label, _text(state.value(TRAINER.name, name), form)
    if not state.cars:
        yield 'decisions/s', _text(state.value(SIMULATOR.name, 'decisions_per_second'), '.0f')
        # the policy may have told of weights that the trainer has not told of yet
        age = (state.value(TRAINER.name, 'weights_version')
               - state.value(POLICY.name, 'weights_version'))
        yield 'weight age (versions)', _text(max(age, 0.0) if age == age else age, '.0f')
    seconds, progress = (state.value(TRAINER.name, name) for name in ('wall_seconds', 'progress'))
    left = seconds * (1 / progress - 1) / 60 if progress > 0 else math.nan
    yield 'minutes so far', _text(seconds / 60, '.1f')
    yield 'minutes left, about', _text(left, '.1f')


def _text(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else '-'


def training_line(state: GraphState) -> str:
    """Return the state of learning as one plain line."""
    minutes = state.value(TRAINER.name, 'wall_seconds')
    if not math.isfinite(minutes):
        return f'learning: {state.summary(TRAINER.name)}'

    def show(label: str, name: str, form: str, node: str = TRAINER.name) -> str:
        value = state.value(node, name)
        return f', {label.format(format(value, form))}' if math.isfinite(value) else ''

    line = f'{minutes / 60:.1f} min'
    if state.value(TRAINER.name, 'episodes') > 0:
        line += (show('episode {}', 'episodes', '.0f') + show('return {}', 'last_return', '.1f')
                 + show('average {}', 'mean_return', '.1f'))
    else:
        line += ', no episode yet' + show('{} decisions', 'decisions', '.0f')
    line += (show('epsilon {}', 'epsilon', '.3f')
             + show('{} updates/s', 'updates_per_second', '.1f')
             + show('{} decisions/s', 'decisions_per_second', '.0f', SIMULATOR.name))
    line += cars_in_words(state)
    if state.validations:
        result = state.validations[-1]
        line += f'; validation {result["mean"]:.1f} ± {result["std"]:.1f}'
    return line


def best_score(folder: Path) -> str:
    """Return the validation score of the best model in brackets, or nothing."""
    # on first use, because torch takes a second to load
    from dqn_policy_node.model_folder import load_model
    with contextlib.suppress(BridgeError, KeyError, TypeError, ValueError):
        score = float(load_model(folder).training['best_validation']['mean'])
        if math.isfinite(score):
            return f' (validation {score:.1f})'
    return ''
