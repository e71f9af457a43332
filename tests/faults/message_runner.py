# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Try one fault on one topic of a graph that is well, and see what comes of it."""
from __future__ import annotations

import time

from faults.outcome import Outcome
from faults.running_graph import RunningGraph
from faults.tables import MessageCase

FAULT_SECONDS = 3.0

PROMISED_SECONDS = 2.0
"""Within which the graph is as it was."""

SPEAKING_SECONDS = 1.5
"""Until a node has said so: diagnostics come once a second."""

PATIENCE_SECONDS = 15.0
"""After which nobody expects it to come back any more."""

STANDS = 1.0
"""Decisions a second below which the car stands; a flood may well slow it down."""

GROWTH_MIB = 200
"""By which a process may grow in one fault: what DDS keeps of a flood, and the replay."""


def try_message_fault(
    graph: RunningGraph, case: MessageCase, seed: int, *, seconds: float = FAULT_SECONDS,
    promised: float = PROMISED_SECONDS,
) -> Outcome:
    """
    Begin a fault, wait for its end, and return whether all was as the table says.

    Args:
        graph: one that is well.
        case: the row of the table.
        seed: of what is random in it.
        seconds: how long it lasts.
        promised: within how many seconds afterwards the graph has to be as it was.
    """
    outcome = Outcome('message', case.kind, case.topic, seed)
    rate, memory, logged = graph.rate(2.0), graph.resident(), graph.logged()
    begin = time.monotonic()
    graph.set_fault(case.topic, case.kind, seconds, seed)
    graph.spin(seconds)
    end = time.monotonic()
    drove = graph.rate(seconds - 0.5)
    try:
        graph.wait_until_well(PATIENCE_SECONDS, since=end, rate=rate)
        outcome.seconds = time.monotonic() - end
        if outcome.seconds > promised + SPEAKING_SECONDS:
            outcome.problems.append(f'as before only after {outcome.seconds:.1f} s')
    except TimeoutError as error:
        outcome.problems.append(f'not as before: {error}')
    told = graph.levels(begin, end + promised)
    outcome.said = told[0] if told else ''
    if case.told and not told:
        outcome.problems.append('silent: every level stayed OK')
    if case.drives and drove < STANDS:
        outcome.problems.append(f'{drove:.1f} decisions/s while it lasted, {rate:.0f} before')
    outcome.problems += after_the_fault(graph, memory, logged)
    return outcome


def after_the_fault(
    graph: RunningGraph, memory: dict[str, float], logged: dict[str, int],
) -> list[str]:
    """Return what must not be after any fault: deaths, tracebacks, memory that grew."""
    problems = graph.log_problems(logged)
    if dead := graph.dead():
        problems.append(dead)
    for name, now in graph.resident().items():
        grown = now - memory.get(name, now)
        if grown > GROWTH_MIB and name != 'fault_node':
            problems.append(f'{name} grew by {grown:.0f} MiB')
    return problems
