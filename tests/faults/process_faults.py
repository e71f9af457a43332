# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a process: signals, and limits of what the system gives it."""
from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import os
import resource
import signal
import time

from faults.message_runner import (
    after_the_fault, PATIENCE_SECONDS, PROMISED_SECONDS, SPEAKING_SECONDS,
)
from faults.outcome import Outcome
from faults.running_graph import RunningGraph
from faults.tables import ProcessCase

END_SECONDS = 20.0
"""Within which a process that is asked to end has ended, on a machine with other work."""

START_SECONDS = 60.0
"""Within which a node that is started again speaks."""

LIMIT_SECONDS = 4.0
STOP_SECONDS = 3.0
# 0 and 130: it ended as asked; 2: one line with the cause
ASKED = (0, 130, -signal.SIGINT)
GAVE_UP = (2,)


def _send(number: signal.Signals) -> Callable[[int], contextlib.AbstractContextManager]:
    @contextlib.contextmanager
    def fault(pid: int) -> Iterator[float]:
        os.kill(pid, number)
        yield 0.0
    return fault


@contextlib.contextmanager
def _stopped(pid: int) -> Iterator[float]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield STOP_SECONDS
    finally:
        os.kill(pid, signal.SIGCONT)


def _limited(kind: int, wanted: Callable[[int], int]) -> Callable:
    @contextlib.contextmanager
    def fault(pid: int) -> Iterator[float]:
        before = resource.prlimit(pid, kind)
        resource.prlimit(pid, kind, (wanted(pid), before[1]))
        try:
            yield LIMIT_SECONDS
        finally:
            with contextlib.suppress(ProcessLookupError):
                resource.prlimit(pid, kind, before)
    return fault


def _open_files(pid: int) -> int:
    return len(os.listdir(f'/proc/{pid}/fd'))


FAULTS = {
    'kill': (_send(signal.SIGKILL), (-signal.SIGKILL,)),
    'terminate': (_send(signal.SIGTERM), ASKED),
    'hang up': (_send(signal.SIGHUP), (*ASKED, -signal.SIGHUP)),
    'interrupt': (_send(signal.SIGINT), ASKED),
    'stop and continue': (_stopped, ()),
    # what is open stays open, and nothing more can be opened
    'few descriptors': (_limited(resource.RLIMIT_NOFILE, _open_files), GAVE_UP),
    # no file may grow: writing fails as it does on a full disk (EFBIG instead of ENOSPC)
    'out of disk': (_limited(resource.RLIMIT_FSIZE, lambda _: 0), GAVE_UP),
}
"""Name -> what is done to a process while a context lasts, exit codes that are right."""


def try_process_fault(
    graph: RunningGraph, case: ProcessCase, seed: int, *, promised: float = PROMISED_SECONDS,
) -> Outcome:
    """
    Do something to a node, start it again if it ended, and return whether all was right.

    Args:
        graph: one that is well.
        case: the row of the table.
        seed: only noted.
        promised: within how many seconds afterwards the graph has to be as it was.
    """
    outcome = Outcome('process', case.fault, case.node, seed)
    fault, codes = FAULTS[case.fault]
    rate, memory, logged = graph.rate(2.0), graph.resident(), graph.logged()
    child = graph.children[case.node]
    begin = time.monotonic()
    with fault(child.process.pid) as seconds:
        graph.spin(seconds)
    if case.ends:
        until = time.monotonic() + END_SECONDS
        while child.code is None and time.monotonic() < until:
            graph.spin(0.05)
    ended = child.code is not None
    if case.ends and not ended:
        outcome.problems.append(f'{case.node} did not end within {END_SECONDS:g} s')
    elif ended and child.code not in codes:
        outcome.problems.append(f'{case.node} ended with {child.code}')
    if ended:
        if case.ends is False:
            outcome.problems.append(f'{case.node} ended')
        outcome.said = ' '.join(list(child.words)[-1:])
        _start_again(graph, case.node, outcome)
    end = graph.word(case.node).at if ended and graph.word(case.node) else time.monotonic()
    try:
        graph.wait_until_well(PATIENCE_SECONDS, since=end, rate=rate)
        outcome.seconds = time.monotonic() - end
        if outcome.seconds > promised + SPEAKING_SECONDS:
            outcome.problems.append(f'as before only after {outcome.seconds:.1f} s')
    except TimeoutError as error:
        outcome.problems.append(f'not as before: {error}')
    told = graph.levels(begin, end + promised)
    outcome.said = outcome.said or (told[0] if told else '')
    if case.told and not outcome.said:
        outcome.problems.append('silent: no line and every level OK')
    outcome.problems += after_the_fault(graph, memory, logged)
    return outcome


def _start_again(graph: RunningGraph, node: str, outcome: Outcome) -> None:
    graph.start_role(node, resume=node == 'trainer')
    until = time.monotonic() + START_SECONDS
    while graph.word(node) is None:
        if time.monotonic() > until or graph.children[node].code is not None:
            outcome.problems.append(f'{node} does not start again: {graph.dead() or "no word"}')
            return
        graph.spin(0.05)
