# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The cars of a trainer as a user sees them: each a row, and a silent one first."""
import io

from carracing_dqn.bringup.cars_display import cars_table
from carracing_dqn.bringup.graph import POLICY, TRAINER
from carracing_dqn.bringup.monitor import GraphState, MAX_CARS
from carracing_dqn.bringup.training_display import training_line, training_table
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import pytest
from rich.console import Console


def status(name, summary='learned from', **values):
    return DiagnosticStatus(name=name, message=summary, values=[
        KeyValue(key=key, value=str(value)) for key, value in values.items()])


def of_trainer(cars, space='', **values):
    trainer = f'{space}/{TRAINER.name}'
    return DiagnosticArray(status=[
        status(trainer, 'learning', wall_seconds=60, episodes=7, weights_version=12, **values),
        *(status(f'{trainer}: {space}/car_{car}', *said, transitions_per_second=40, lag=0.02,
                 last_return=-3.5, lost=car, silent_seconds=20 if said else 0)
          for car, *said in cars)])


def shown(table, width=80):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text().splitlines()


@pytest.mark.parametrize('space', ['', '/there'])
def test_each_car_has_a_row_and_a_silent_one_comes_first(space):
    state = GraphState(space)
    state.take_diagnostics(of_trainer([(2,), (10,), (1, 'no step at the moment')], space))
    state.take_diagnostics(DiagnosticArray(status=[
        status(f'{space}/car_2/{POLICY.name}', 'driving', epsilon=0.125, weights_version=9)]))
    lines = shown(training_table(state, 40))
    rows = [line for line in lines if 'car_' in line]
    assert [row.split()[1] for row in rows] == ['car_1', 'car_2', 'car_10']
    assert 'silent 20 s' in rows[0]
    assert rows[1].split()[3:-1:2] == ['40', '0.02', '0.125', '-3.5', '2', '3']
    assert max(map(len, lines)) <= 80
    assert '; 3 cars, 120 transitions/s, /car_1: silent 20 s' in training_line(state).replace(
        space, '')
    # one that the trainer has forgotten
    state.take_diagnostics(of_trainer([(10,)], space))
    assert list(state.cars) == [f'{space}/car_10'] and f'{space}/car_2' not in str(state.health)


@pytest.mark.parametrize('rows', [8, 12, 24, 60])
def test_many_cars_fit_into_few_lines_and_none_is_left_out_of_the_sum(rows):
    state = GraphState()
    state.take_diagnostics(of_trainer([(car,) for car in range(63)] + [(63, 'no image_raw')]))
    lines = shown(cars_table(state, rows))
    assert len(lines) <= max(rows, 7)
    assert 'car_63' in lines[3]
    listed = sum('car_' in line for line in lines)
    assert any(f'{64 - listed} more' in line for line in lines)


def test_what_comes_in_their_place_is_bounded_and_no_text_of_theirs_is_markup():
    state = GraphState()
    state.take_diagnostics(of_trainer([(car,) for car in range(3 * MAX_CARS)]))
    assert len(state.cars) == MAX_CARS
    state.take_diagnostics(DiagnosticArray(status=[
        status(f'/{TRAINER.name}', 'learning'),
        status(f'/{TRAINER.name}: /[bold]\x1b[31m{"x" * 500}', '[/x]' * 100, lag='nan')]))
    text = '\n'.join(shown(training_table(state, 24)))
    assert '\x1b' not in text and '[/x]' in text
    # a stranger's parts are nobody's cars
    state.take_diagnostics(DiagnosticArray(status=[status('/other/trainer_node: /car_9')]))
    assert len(state.cars) == 1


def test_a_sign_that_is_a_digit_and_no_number_ends_nothing():
    state = GraphState()
    state.take_diagnostics(of_trainer([('\u00b2',), (2,), ('\u0662',)]))
    assert sum('car_' in line for line in shown(cars_table(state, 30))) == 3
    assert '; 3 cars' in training_line(state)
