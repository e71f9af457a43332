# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Jobs shared out over processes that are started afresh (spawn) and end with their parent."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import contextlib
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
import signal
import sys
import threading
import traceback
from typing import Any, TypeVar

from carracing_dqn.evaluation.errors import EvaluationError
from msgs_bridge.errors import BridgeError

Job = TypeVar('Job')
Result = TypeVar('Result')

# read by the numeric libraries when they are loaded: one core for each process
THREAD_VARIABLES = ('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'OPENBLAS_NUM_THREADS')


def run_jobs(
    make_worker: Callable[[], Callable[[Job], Result]], jobs: Iterable[Job], processes: int,
) -> Iterator[Result]:
    """
    Yield the result of every job as it comes, in any order.

    Args:
        make_worker: called once in each process; returns what does one job. Can be pickled.
        jobs: what to do; can be pickled.
        processes: how many processes to start, at most one a job.

    Raises:
        EvaluationError: a process died (the text has its exit code).
        BridgeError: what `make_worker` or a job raised; anything else they raise comes as the
            text of an EvaluationError.
    """
    waiting = list(jobs)[::-1]
    context = multiprocessing.get_context('spawn')
    workers: dict[Connection, Any] = {}
    try:
        with _inherited_by_children():
            for _ in range(min(processes, len(waiting))):
                ours, theirs = context.Pipe()
                worker = context.Process(target=_work, args=(theirs, make_worker), daemon=True)
                worker.start()
                theirs.close()
                workers[ours] = worker
        for connection in workers:
            connection.send(waiting.pop())
        busy = set(workers)
        while busy:
            for connection in wait(list(busy)):
                yield _receive(connection, workers[connection])
                if waiting:
                    connection.send(waiting.pop())
                else:
                    busy.discard(connection)
    finally:
        for connection, worker in workers.items():
            connection.close()
            worker.terminate()
        for worker in workers.values():
            worker.join()


def _receive(connection: Connection, worker: Any) -> Any:
    """Return what a worker sends, or raise what it raised."""
    try:
        failed, answer = connection.recv()
    except EOFError:
        worker.join()
        raise EvaluationError(
            f'a process that drove laps died with exit code {worker.exitcode}') from None
    if failed:
        raise answer
    return answer


@contextlib.contextmanager
def _inherited_by_children() -> Iterator[None]:
    """Let processes started meanwhile ignore Ctrl-C, which is the parent's, and use one thread."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, '1'))
    in_main_thread = threading.current_thread() is threading.main_thread()
    if in_main_thread:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        if in_main_thread:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _work(connection: Connection, make_worker: Callable[[], Callable[[Any], Any]]) -> None:
    """Do jobs until the parent closes the connection or is gone."""
    # a handler of the parent's, inherited through its main module, must not outlive terminate()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    worker = None
    while True:
        try:
            job = connection.recv()
        except (EOFError, OSError):
            return
        try:
            if worker is None:
                worker = make_worker()
                limit_torch_threads()
            answer = (False, worker(job))
        except BridgeError as error:
            answer = (True, error)
        except Exception:
            # as text: not every exception can be sent, and its traceback never is
            answer = (True, EvaluationError(
                f'a process that drove laps failed:\n{traceback.format_exc().rstrip()}'))
        try:
            connection.send(answer)
        except OSError:
            return


def limit_torch_threads() -> None:
    """Let torch, if it is loaded by now, use one thread in this process."""
    if 'torch' in sys.modules:
        sys.modules['torch'].set_num_threads(1)
