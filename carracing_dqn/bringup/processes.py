# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as child processes: started together, watched, and stopped in order."""
from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from types import MappingProxyType
from typing import Any

from carracing_dqn.bringup.graph import Graph, RECORDER
from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import FINISHED, INTERRUPTED
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import open_at_once

CHILD = 'carracing_dqn.bringup.child'
"""What a node that a command has started is before it is itself."""

LAST_WORDS = 12
"""Lines of output that are kept for the message about a child that died."""

MAX_REASON = 300
"""Characters of what a child said last that are quoted."""

STOP_SECONDS = 2.5
"""How long children have after SIGINT before those with nothing to save are killed."""

SAVE_SECONDS = 15.0
"""How long those have that save something, which a busy machine or a slow disk may take."""

RECORDER_SECONDS = 0.7
"""How long before the others are killed a recorder is asked to complete its bag."""

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class ChildDied(BridgeError):
    """A node ended before its work was done; the message says which, how, and what it said."""


def node_command(
    module: str, parameters: Mapping[str, Any], namespace: str = '', *, nice: int = 0,
    folder: Path | str = '.', supervised: bool = False,
    remaps: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """
    Return the command line of one of our nodes, which ends when this process does.

    Args:
        module: what `python -m` runs.
        parameters: values by name; str, int, float and bool.
        namespace: ROS namespace; empty for none.
        nice: how much of its share of the processor it leaves to others.
        folder: its current folder.
        supervised: whether it ends with `FINISHED`, not with 0, when its work is done, and with
            `INTERRUPTED` when a signal stops it.
        remaps: what its topics are called instead.
    """
    command = [
        sys.executable, '-m', CHILD, '--parent', str(os.getpid()),
        '--nice', str(nice), f'--folder={folder}',
        *(['--supervised'] if supervised else []), '-m', module, '--ros-args']
    if namespace:
        command += ['-r', f'__ns:=/{namespace.strip("/")}']
    for name, value in remaps.items():
        command += ['-r', f'{name}:={value}']
    for name, value in parameters.items():
        if isinstance(value, bool):
            text = str(value).lower()
        elif isinstance(value, str):
            # quoted as YAML, so that a name like "1e5" stays a text
            text = "'" + value.replace("'", "''") + "'"
        else:
            text = repr(value)
        command += ['-p', f'{name}:={text}']
    return command


class Child:
    """
    One process, its log file and its last words.

    Attributes:
        name: names it in messages.
        log: file that takes what it says; what the disk does not take is lost.
        words: the last lines that it said.
        spoke_at: when it said its first line, `time.monotonic()`; None before.
        keeps: whether it has something to save when it is stopped.
        expendable: whether the others go on without it.
        asked: whether it was asked to stop.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, *, keeps: bool = False,
        expendable: bool = False,
    ) -> None:
        """Start the process; raises OSError when the log or the process cannot be had."""
        self.name, self.log, self.keeps, self.expendable = name, log, keeps, expendable
        self.words: deque[str] = deque(maxlen=LAST_WORDS)
        self.spoke_at: float | None = None
        self.asked = False
        # one thread each: libraries that start one a core take them from the other nodes
        environment = {'OMP_NUM_THREADS': '1', **os.environ, 'PYTHONUNBUFFERED': '1',
                       'RCUTILS_COLORIZED_OUTPUT': '0'}
        # not `with`: the reading thread has it until the process ends
        file = os.fdopen(open_at_once(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT), 'a',
                         encoding='utf-8')
        # a child inherits that SIGINT waits, until `child` says what it means: Python's own start
        # would answer it with a traceback
        waits = {signal.SIGINT} if CHILD in command else set()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, waits)
        try:
            self.process = subprocess.Popen(
                list(command), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, errors='replace', env=environment,
                # so that Ctrl-C in a terminal reaches only this process
                start_new_session=True)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._reader = threading.Thread(target=self._read, args=(file,), daemon=True)
        self._reader.start()

    def _read(self, log: Any) -> None:
        with contextlib.suppress(OSError), log:
            for line in self.process.stdout:
                self.spoke_at = self.spoke_at or time.monotonic()
                self.words.append(line.rstrip())
                # on a full disk the child must not stand still because nobody reads
                with contextlib.suppress(OSError):
                    log.write(line)
                    log.flush()

    @property
    def code(self) -> int | None:
        """Return the exit code, None while it runs."""
        return self.process.poll()

    @property
    def failed(self) -> bool:
        """Return whether it has ended otherwise than by finishing, or by being asked to stop."""
        accepted = (None, FINISHED)
        if self.asked:
            accepted += (INTERRUPTED, -signal.SIGINT, -signal.SIGKILL)
        return self.code not in accepted

    def said(self, text: str) -> bool:
        """Return whether a text stands in the last words."""
        return any(text in line for line in list(self.words))

    def signal(self, number: signal.Signals) -> None:
        """Send a signal if it still runs."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(number)

    def obituary(self) -> str:
        """Return in one line how it ended and why, as far as it has said so."""
        self._reader.join(timeout=1.0)
        code = self.code
        if code == INTERRUPTED:
            return f'{self.name} was stopped from outside before the work was done'
        ended = f'signal {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'
        if code == 0:
            ended += ' before its work was done'
        # a node that gives up says why in such a line; a traceback has the reason in its last,
        # and what was said before a signal has nothing to do with it
        reasons = [line for line in self.words if line.startswith('error: ')]
        reasons = reasons or [line for line in self.words if line.strip() and code > 0]
        reason = f': {plain(reasons[-1].removeprefix("error: "), MAX_REASON)}' if reasons else ''
        return f'{self.name} ended with {ended}{reason} (log: {self.log})'


class ProcessGroup:
    """Children that live and end together; a context manager that always stops them."""

    def __init__(self, log_folder: Path) -> None:
        """Write a log file per child into a folder that exists."""
        self.log_folder = log_folder
        self.children: dict[str, Child] = {}
        self._told: set[str] = set()

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(
        self, name: str, command: Sequence[str], *, keeps: bool = False,
        expendable: bool = False,
    ) -> Child:
        """
        Start a child under a name.

        Raises:
            BridgeError: its log cannot be written, or the system has no room for a process.
        """
        log = self.log_folder / f'{name}.log'
        try:
            child = Child(name, command, log, keeps=keeps, expendable=expendable)
        except OSError as error:
            raise BridgeError(f'{name} cannot be started, log {log}: {error.strerror}') from None
        self.children[name] = child
        return child

    def start_graph(self, graph: Graph, namespace: str, folder: Path | str) -> None:
        """
        Start the nodes of a graph, each under its role.

        Args:
            graph: the nodes, in the order in which they start.
            namespace: their ROS namespace; empty for none.
            folder: their current folder, from which paths in their parameters count.

        Raises:
            BridgeError: as `start`.
        """
        for node in graph:
            kind = node.kind
            self.start(node.role, node_command(
                kind.module, node.parameters, node.namespace(namespace), nice=kind.nice,
                folder=folder, supervised=True, remaps=node.remaps(namespace)),
                keeps=kind.keeps, expendable=bool(node.space))

    def check(self) -> str | None:
        """
        Return the name of a child that has finished its work, by its exit code, else None.

        Raises:
            ChildDied: one ended otherwise, or of every car a node did.
            BridgeError: the folder of the logs was removed, and what is beside it with it.
        """
        finished = None
        parts = [child for child in self.children.values() if child.expendable]
        gone = [child for child in parts if child.code is not None]
        # one without its policy stands; a role is followed by the space of its car
        if parts and not ({child.name.partition('_')[2] for child in parts}
                          - {child.name.partition('_')[2] for child in gone}):
            raise ChildDied(f'no car is left: {gone[-1].obituary()}')
        for name, child in self.children.items():
            if child.expendable:
                continue
            if child.failed:
                raise ChildDied(child.obituary())
            if child.code == FINISHED:
                finished = finished or name
        if not self.log_folder.is_dir():
            raise BridgeError(f'{self.log_folder} was removed while it was written to')
        return finished

    def losses(self) -> list[str]:
        """Return a line for each expendable child that has ended since the last call."""
        gone = [child for child in self.children.values()
                if child.expendable and child.code is not None and child.name not in self._told]
        self._told.update(child.name for child in gone)
        return [f'{child.obituary()}; the others go on' for child in gone]

    def up_for(self) -> float:
        """Return how many seconds every child has been up, by its first line; 0 before."""
        spoke_at = [child.spoke_at for child in self.children.values()]
        return 0.0 if None in spoke_at else time.monotonic() - max(spoke_at)

    def stop(self) -> None:
        """
        Stop all children: SIGINT to all, to recorders last; those that do not end are killed.

        Signals that end this process are ignored meanwhile, so that nothing is left over.
        """
        running = [child for child in self.children.values() if child.code is None]
        recorders = [child for child in running if child.name == RECORDER.role]
        others = [child for child in running if child not in recorders]
        with _undisturbed():
            deadline = time.monotonic() + STOP_SECONDS
            _ask(others)
            _wait(others, deadline - RECORDER_SECONDS if recorders else deadline)
            _ask(recorders)
            _wait([child for child in running if not child.keeps], deadline)
            for child in running:
                if not child.keeps:
                    child.signal(signal.SIGKILL)
            _wait(running, deadline + SAVE_SECONDS - STOP_SECONDS)
            for child in running:
                child.signal(signal.SIGKILL)
                child.process.wait()

    def check_ends(self) -> None:
        """
        Look how the children ended that were stopped.

        Raises:
            ChildDied: one did not save what it had to.
        """
        for child in self.children.values():
            if child.keeps and child.code == -signal.SIGKILL:
                raise ChildDied(f'{child.name} had not saved everything after {SAVE_SECONDS:g} s '
                                f'and was killed (log: {child.log})')
            if child.failed and not child.expendable:
                raise ChildDied(child.obituary())


def _ask(children: Sequence[Child]) -> None:
    for child in children:
        child.asked = True
        child.signal(signal.SIGINT)


def _wait(children: Sequence[Child], until: float) -> None:
    """Wait until children have ended, but not longer than until a time."""
    for child in children:
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.process.wait(max(0.01, until - time.monotonic()))


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Ignore the signals that end this process, where the main thread can say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: a handler that Python has not set and cannot put back
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
