# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How each of several cars looks while a trainer learns from them: a row, the odd ones first."""
from __future__ import annotations

import math
import re

from carracing_dqn.bringup.graph import POLICY, TRAINER
from carracing_dqn.bringup.monitor import GraphState, number, SUMMARY
from rich.table import Table
from rich.text import Text

# from so long on a car that sends nothing is called silent; seconds
SILENT_SECONDS = 3.0
COLUMNS = ('car', 'rate', 'lag s', 'epsilon', 'return', 'lost', 'age')
HEADER = 4
WIDTH = 80
LEAST_ROWS = 3


def cars_table(state: GraphState, rows: int) -> Table:
    """
    Return the cars of a trainer, those that something is wrong with first.

    Args:
        state: of the graph.
        rows: lines that it may have; the cars that do not fit are summed up.
    """
    table = Table(padding=(0, 1), width=WIDTH)
    for column in COLUMNS:
        table.add_column(column, justify='left' if column == 'car' else 'right', no_wrap=True)
    table.add_column('', ratio=1, no_wrap=True, overflow='ellipsis')
    cars = sorted(state.cars, key=lambda car: (not _trouble(state, car), _in_order(car)))
    fits = max(rows - HEADER, LEAST_ROWS)
    shown = cars if len(cars) <= fits else cars[:fits - 1]
    for car in shown:
        trouble = _trouble(state, car)
        table.add_row(*map(Text, _cells(state, car)), Text(trouble),
                      style='bold red' if trouble else None)
    rest = cars[len(shown):]
    if rest:
        rate = sum(_rate(state, car) for car in rest)
        lost = sum(number(state.cars[car], 'lost', 0.0) for car in rest)
        table.add_row(f'{len(rest)} more', f'{rate:.0f}', '', '', '', f'{lost:.0f}', '', '')
    return table


def cars_in_words(state: GraphState) -> str:
    """Return how many cars there are and which are odd, to follow in a line; '' without any."""
    if not state.cars:
        return ''
    rate = sum(_rate(state, car) for car in state.cars)
    line = f'; {len(state.cars)} cars, {rate:.0f} transitions/s'
    odd = [car for car in sorted(state.cars, key=_in_order) if _trouble(state, car)]
    if odd:
        line += f', {odd[0]}: {_trouble(state, odd[0])}'
    if len(odd) > 1:
        line += f' (and {len(odd) - 1} more)'
    return line


def _cells(state: GraphState, car: str) -> list[str]:
    said = state.cars[car]
    # the policy may have told of weights that the trainer has not told of yet
    age = (state.value(TRAINER.name, 'weights_version')
           - state.value(POLICY.name, 'weights_version', space=car))
    name = car.removeprefix(f'{state.namespace}/')
    return [
        name if len(name) <= 16 else f'{name[:15]}…', f'{_rate(state, car):.0f}',
        _text(number(said, 'lag'), '.2f'),
        _text(state.value(POLICY.name, 'epsilon', space=car), '.3f'),
        _text(number(said, 'last_return'), '.1f'), _text(number(said, 'lost'), '.0f'),
        _text(max(age, 0.0) if age == age else age, '.0f')]


def _rate(state: GraphState, car: str) -> float:
    return number(state.cars[car], 'transitions_per_second', 0.0)


def _trouble(state: GraphState, car: str) -> str:
    """Return what is wrong with a car in few words, '' if nothing is."""
    said = state.cars[car]
    seconds = number(said, 'silent_seconds', 0.0)
    if seconds > SILENT_SECONDS:
        return f'silent {seconds:.0f} s: {said[SUMMARY]}'
    return '' if said[SUMMARY] == 'learned from' else said[SUMMARY]


def _in_order(car: str) -> list[object]:
    """Return what sorts car_2 before car_10."""
    return [(int(part), '') if part.isdecimal() else (-1, part)
            for part in re.split(r'([0-9]+)', car)]


def _text(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else '-'
