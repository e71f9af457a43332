# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Jobs shared out over processes that are started afresh (spawn) and end with their parent."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import as_completed, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from typing import Any, TypeVar

from carracing_dqn.evaluation.errors import EvaluationError
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain

Job = TypeVar('Job')
Result = TypeVar('Result')

# read by the numeric libraries when they are loaded: one core for each process
THREAD_VARIABLES = ('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'OPENBLAS_NUM_THREADS')

_worker: Callable[[Any], Any] | None = None


def run_jobs(
    make_worker: Callable[[], Callable[[Job], Result]], jobs: Iterable[Job], processes: int,
) -> Iterator[Result]:
    """
    Yield the result of every job as it comes, in any order.

    Leaving the iterator early ends the processes at once.

    Args:
        make_worker: called once in each process; returns what does one job. Can be pickled.
        jobs: what to do; can be pickled.
        processes: how many processes to start, at most one a job.

    Raises:
        EvaluationError: a process died.
        BridgeError, OSError, MemoryError: what `make_worker` or a job raised; anything else they
            raise comes as the text of an EvaluationError.
    """
    jobs = list(jobs)
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(
        max(1, min(processes, len(jobs))), multiprocessing.get_context('spawn'), _begin)
    try:
        # the processes start here, with Ctrl-C blocked for good: it is the parent's
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            futures = [executor.submit(_work, make_worker, job) for job in jobs]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool:
        raise EvaluationError('a process that drove laps died') from None
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        executor.shutdown()


def _begin() -> None:
    """Use one thread, and end when the parent is gone."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, '1'))

    def end_with_parent() -> None:
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _work(make_worker: Callable[[], Callable[[Any], Any]], job: Any) -> Any:
    """Do one job."""
    global _worker
    try:
        if _worker is None:
            _worker = make_worker()
            limit_torch_threads()
        return _worker(job)
    except (BridgeError, OSError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        # as text: not every exception can be sent, and its traceback never is; the cause first,
        # because a long text is cut
        raise EvaluationError(
            f'a process that drove laps failed: {type(error).__name__}: {plain(error, 300)}\n'
            f'{traceback.format_exc().rstrip()}') from None


def limit_torch_threads() -> None:
    """Let torch, if it is loaded by now, use one thread in this process."""
    if 'torch' in sys.modules:
        sys.modules['torch'].set_num_threads(1)
