# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What a program that listens takes off the decisions per second of a lockstep run.

Simulator and random policy run all the time, which is the fastest lockstep run there is; the
listener comes and goes, so that with and without alternate within one run.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import os
from pathlib import Path
import signal
import statistics
import subprocess
import sys
import time
from typing import Any

from bags.reader import BagReader
from carracing_dqn.benchmarks.process_cost import cost_of
from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.topics import STEP

# seconds that it has to start and to settle, or to be gone
SETTLE = 2.5
STOP_SECONDS = 5.0
START_SECONDS = 60.0
# below the ports that Linux hands out, and above what people use
DOMAIN = 97


def listener_cost(
    begin: Callable[[int], subprocess.Popen], *, rounds: int = 12, seconds: float = 4.0,
    settle: float = SETTLE, after: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """
    Return decisions/s with and without a program that listens, and the time it needed.

    Args:
        begin: starts it; gets the number of the round.
        rounds: how often it comes and goes, at least 2.
        seconds: length of one measurement.
        settle: seconds that it has to start and to settle.
        after: called when it has ended.
    """
    os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
    before_rclpy()
    simulator = start_node('carracing_sim_node.node', seed=42)
    policy = start_node('dqn_policy_node.node', model='random')
    rates: dict[str, list[float]] = {'without': [], 'with': []}
    cpu = []
    counter = _StepCounter()
    try:
        deadline = time.monotonic() + START_SECONDS
        while not counter.rate(SETTLE) > 0:
            if time.monotonic() > deadline:
                raise TimeoutError(f'the simulator did not drive within {START_SECONDS:.0f} s')
        rates['without'].append(counter.rate(seconds))
        for number in range(rounds):
            listener = begin(number)
            counter.rate(settle)
            before = cost_of(listener.pid).seconds
            rates['with'].append(counter.rate(seconds))
            cpu.append((cost_of(listener.pid).seconds - before) / seconds)
            _stop(listener)
            after(number)
            counter.rate(1.0)
            rates['without'].append(counter.rate(seconds))
    finally:
        counter.close()
        for process in (policy, simulator):
            _stop(process)
    # neighbours in time are compared, because other work on the machine comes and goes
    without = rates['without']
    costs = [100 * (1 - 2 * on / (before + after_it))
             for on, before, after_it in zip(rates['with'], without, without[1:])]
    return {
        'decisions_per_second_without': statistics.median(rates['without']),
        'decisions_per_second_with': statistics.median(rates['with']),
        'cost_percent': statistics.mean(costs),
        'cost_percent_error': statistics.stdev(costs) / rounds ** 0.5,
        'cost_percent_by_round': costs,
        'cpu_percent': 100 * statistics.median(cpu),
    }


def recorder_cost(folder: Path, *, rounds: int = 12, seconds: float = 4.0) -> dict[str, Any]:
    """Return what a recorder with bags in a folder costs, and what it lost."""
    messages = lost = 0

    def look(number: int) -> None:
        nonlocal messages, lost
        with BagReader(folder / f'round_{number}') as reader:
            messages += reader.message_count
            lost += sum(_missing(reader).values())

    figures = listener_cost(
        lambda number: start_node('bags.recorder_node', folder=str(folder / f'round_{number}')),
        rounds=rounds, seconds=seconds, after=look)
    return {**figures, 'messages_recorded': messages, 'steps_missing': lost}


class _StepCounter:
    """Reads the simulator's own count of decisions, at no cost to the run."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        self._rclpy = rclpy
        rclpy.init()
        self._node = rclpy.create_node('listener_cost')
        self._rates: list[float] = []
        self._skip = 0
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._take, 10)

    def rate(self, seconds: float) -> float:
        """Return the mean decisions/s over the next seconds."""
        # the first one covers the time before as well
        self._rates.clear()
        self._skip = 1
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._rclpy.spin_once(self._node, timeout_sec=0.1)
        return statistics.mean(self._rates) if self._rates else float('nan')

    def close(self) -> None:
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _take(self, message: Any) -> None:
        for status in message.status:
            if status.name == '/carracing_sim_node':
                if self._skip:
                    self._skip -= 1
                    continue
                self._rates += [float(pair.value) for pair in status.values
                                if pair.key == 'decisions_per_second']


def start_node(module: str, **parameters: Any) -> subprocess.Popen:
    """Start a node with parameters, in silence."""
    command = [sys.executable, '-m', module, '--ros-args']
    for name, value in parameters.items():
        command += ['-p', f'{name}:={value}']
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _stop(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGINT)
    try:
        process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()


def _missing(reader: BagReader) -> Counter[str]:
    """Return how many decisions are missing between the first and the last in a bag."""
    from bags.decode import decode_bundle
    missing: Counter[str] = Counter()
    last = None
    for message in reader.messages(['/step']):
        facts = decode_bundle(message.data, STEP.name).values_with(('episode', 'decision'))
        present = (facts['episode'], facts['decision'])
        if last is not None and present[0] == last[0]:
            missing['step'] += int(present[1] - last[1] - 1)
        last = present
    return missing
