# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of many cars: its feeder's pace, what it reads of the system, its tables."""
import os
import subprocess
import sys
import time

from bag_cases import record_drive
from carracing_dqn.benchmarks import bench_cars, car_feeder_node
from carracing_dqn.benchmarks.car_feeder_node import Pace, read_messages
from carracing_dqn.benchmarks.process_cost import children_of, cost_of, loopback_bytes
from carracing_dqn.bringup.graph import SIMULATOR
from graph_probe import wait_for
import pytest
from rich.console import Console


def test_the_pace_rises_until_somebody_is_held(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(car_feeder_node.time, 'monotonic', lambda: now[0])
    pace = Pace()

    def sent(seconds, held=False):
        total = 0
        for _ in range(round(seconds / 0.01)):
            now[0] += 0.01
            total += pace.due(held)
        return total

    first, second = sent(1.0), sent(1.0)
    assert 100 < first < second / 1.5
    assert sent(5.0, held=True) == 0
    # nothing is made up for, and it goes on a little slower
    third = sent(0.1)
    assert 0 < third < sent(0.1) < second


def test_a_bag_is_read_as_what_a_car_sends(tmp_path):
    record_drive(tmp_path / 'bag', episodes=1)
    messages = read_messages(tmp_path / 'bag')
    kinds = [kind for kind, _ in messages]
    assert set(kinds) == {0, 1, 2} and all(data[:2] == b'\0\1' for _, data in messages)
    assert kinds.count(0) == kinds.count(1)


def test_what_processes_cost_is_read():
    child = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
    try:
        wait_for(lambda: cost_of(child.pid).seconds > 0.2, 30, 'work')
        assert cost_of(child.pid).resident > 10**6
        assert 'while True' in children_of(os.getpid())[child.pid]
    finally:
        child.kill()
        child.wait()
    assert cost_of(child.pid) == (0.0, 0)
    assert loopback_bytes() >= 0 and time.monotonic() > 0


def test_tables_are_of_80_columns():
    figures = {'transitions_per_second': 1234.5, 'updates_per_second': 123.4, 'trainer_cpu': 0.97,
               'trainer_MB': 1234.0, 'car_cpu': 1.3, 'car_MB': 500.0,
               'loopback_kB_per_second': 345.6}
    console = Console(width=80, record=True, file=open(os.devnull, 'w'))  # noqa: SIM115
    console.print(bench_cars.fed_table([{'cars': 64, 'off': figures, 'on': figures}]))
    console.print(bench_cars.driving_table([{'cars': 8, 'idle': figures, 'busy': figures}]))
    text = console.export_text()
    assert '1234' in text and '…' not in text and max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize('text', ['x', '1,', '1.5'])
def test_a_number_of_cars_that_is_none_is_refused(text, capsys):
    with pytest.raises(SystemExit):
        bench_cars.main(['--fed', text])
    assert 'invalid' in capsys.readouterr().err


def test_the_feeder_serves_what_the_trainer_calls():
    assert SIMULATOR.name == car_feeder_node.HOLDER
