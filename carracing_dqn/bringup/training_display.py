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
from carracing_dqn.watch.painting import spark
from dqn_policy_node.model_record import read_model_record
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from trainer_node.run_folder import RunFolder
from trainer_node.settings import LEARNING, PRETRAINING, TOO_SLOW, VALIDATING

LIVE_VALUES = (
    ('return, last episode', 'last_return', '.1f'),
    ('return, moving average', 'mean_return', '.1f'),
    ('episodes', 'episodes', '.0f'),
    ('decisions', 'decisions', '.0f'),
    ('updates', 'updates', '.0f'),
    ('epsilon', 'epsilon', '.3f'),
    ('epsilon at the end, about', 'epsilon_at_end', '.2f'),
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

# what a trainer says that lacks nothing
WELL = ('starting', LEARNING, PRETRAINING, VALIDATING)
SHOWN_VALIDATIONS = 3
WIDTH = 80
# of what the trainer says, so that it stays in two lines
MAX_SUMMARY = 150

CURVE_ROWS = 3
FRAME = 5
"""Lines of a table that are no rows: frame, what the trainer says, prompt."""


def training_table(state: GraphState, rows: int) -> RenderableType:
    """Return the state of learning as tables of 80 columns and fewer than `rows` lines."""
    table = Table(show_header=False, padding=(0, 1))
    for _ in range(2):
        table.add_column()
        table.add_column(justify='right')
    entries = list(_entries(state))
    half = (len(entries) + 1) // 2
    for left, right in zip(entries[:half], [*entries[half:], ('', '')]):
        table.add_row(*left, *right)
    said = state.summary(TRAINER.name)
    parts: list[RenderableType] = [
        Text(plain(said, MAX_SUMMARY), style='' if said in WELL else 'yellow'), table]
    validations = list(state.validations)[-1 if state.cars else -SHOWN_VALIDATIONS:]
    if validations:
        parts.append(Text('validation of version ' + '\n'.join(
            f'{result["version"]:.0f}: {result["mean"]:.1f} ± {result["std"]:.1f}, '
            f'{result["completed"]:.0%} completed' for result in validations)))
    used = table.row_count + FRAME + len(validations)
    if state.cars:
        # the rest of the screen is theirs
        parts.append(cars_table(state, rows - used))
    elif rows - used > CURVE_ROWS:
        parts += _curve(state)
    return Group(*parts)


def _curve(state: GraphState) -> Iterator[Text]:
    """Yield the returns so far as a line of words and lines of bars, once there are some."""
    points = state.curve.points
    if len(points) < 2:
        return
    last, values = points[-1][0], [value for _, value in points]
    yield Text(f'return, moving average: {min(values):.1f} to {max(values):.1f} within '
               f'{(last - points[0][0]) / 60:.1f} min', style='dim')
    yield Text(spark([(last - at, value) for at, value in points], WIDTH - 1, CURVE_ROWS),
               style='blue')


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
    said = state.summary(TRAINER.name)
    if said.startswith(TOO_SLOW):
        # what would fit stands once in the trainer's log, and in its diagnostics
        line += f'; {TOO_SLOW}' + show('epsilon at the end about {}', 'epsilon_at_end', '.2f')
    elif said not in WELL:
        line += f'; {said}'
    if state.validations:
        result = state.validations[-1]
        line += f'; validation {result["mean"]:.1f} ± {result["std"]:.1f}'
    return line


def model_lines(folder: Path) -> Iterator[str]:
    """Yield a line for each model that a run has left in its folder."""
    run = RunFolder(folder)
    for name, path in (('best', run.best), ('final', run.final)):
        if path.is_dir():
            yield f'{name} model: {path}{model_score(path)}'


def model_score(folder: Path) -> str:
    """Return what the validation said of a model of a run, in brackets."""
    with contextlib.suppress(BridgeError, KeyError, TypeError, ValueError):
        record = read_model_record(folder)
        for result in (record.training['validation'], record.training['best_validation']):
            # of the version that was validated last there may be a later one
            if result and result['version'] == record.version:
                return f' (validation {float(result["mean"]):.1f})'
    return ' (not validated)'
