# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as child processes: started together, watched, and stopped in order."""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import contextlib
import ctypes
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from msgs_bridge.errors import BridgeError

LAST_WORDS = 12
"""Lines of output that are kept for the message about a child that died."""

STOP_SECONDS = 2.5
"""How long children have after SIGINT before they are killed."""

PR_SET_PDEATHSIG = 1


class ChildDied(BridgeError):
    """A node ended on its own; the message has its name, exit code and last words."""


def die_with_parent() -> None:
    """Ask the kernel (Linux) for SIGTERM when the parent is gone, however it went."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def node_command(
    module: str, parameters: dict[str, object], namespace: str = '',
) -> list[str]:
    """
    Return the command line of one of our nodes.

    Args:
        module: importable module with a `main`, run with `python -m`.
        parameters: values by name; str, int, float and bool.
        namespace: ROS namespace; empty for none.
    """
    command = [sys.executable, '-m', module, '--ros-args']
    if namespace:
        command += ['-r', f'__ns:=/{namespace.strip("/")}']
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
    """One process, its log file and its last words."""

    def __init__(self, name: str, command: Sequence[str], log: Path, *, nice: int = 0) -> None:
        """Start the process; what it says goes to the log file."""
        self.name = name
        self.log = log
        self.words: deque[str] = deque(maxlen=LAST_WORDS)
        # one thread each: libraries that start one a core take them from the other nodes
        environment = {'OMP_NUM_THREADS': '1', **os.environ, 'PYTHONUNBUFFERED': '1',
                       'RCUTILS_COLORIZED_OUTPUT': '0'}

        def prepare() -> None:
            die_with_parent()
            os.nice(nice)

        self.process = subprocess.Popen(
            list(command), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors='replace', env=environment, start_new_session=True, preexec_fn=prepare)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with self.log.open('a', encoding='utf-8') as log:
            for line in self.process.stdout:
                self.words.append(line.rstrip())
                log.write(line)
                log.flush()

    @property
    def code(self) -> int | None:
        """Return the exit code, None while it runs."""
        return self.process.poll()

    def said(self, text: str) -> bool:
        """Return whether a text stands in the last words."""
        return any(text in line for line in list(self.words))

    def signal(self, number: signal.Signals) -> None:
        """Send a signal if it still runs."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(number)

    def obituary(self) -> str:
        """Return name, exit code and last words."""
        self._reader.join(timeout=1.0)
        code = self.code
        ended = f'signal {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'
        words = '\n'.join(f'  {line}' for line in self.words)
        return f'{self.name} ended with {ended}; its last words ({self.log}):\n{words}'


class ProcessGroup:
    """Children that live and end together; a context manager that always stops them."""

    def __init__(self, log_folder: Path) -> None:
        """Write a log file per child into a folder that exists."""
        self.log_folder = log_folder
        self.children: dict[str, Child] = {}

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, command: Sequence[str], *, nice: int = 0) -> Child:
        """Start a child under a name."""
        child = Child(name, command, self.log_folder / f'{name}.log', nice=nice)
        self.children[name] = child
        return child

    def check(self) -> str | None:
        """
        Return the name of a child that has finished its work (exit code 0), else None.

        Raises:
            ChildDied: one ended with another code, or by a signal.
        """
        for name, child in self.children.items():
            code = child.code
            if code == 0:
                return name
            if code is not None:
                raise ChildDied(child.obituary())
        return None

    def wait_until_said(self, name: str, text: str, seconds: float) -> None:
        """
        Wait until a child has said a text.

        Raises:
            ChildDied: a child ended, or nothing was said in time.
        """
        deadline = time.monotonic() + seconds
        while not self.children[name].said(text):
            if self.check() is not None or time.monotonic() > deadline:
                raise ChildDied(f'{name} did not say {text!r} within {seconds:g} s; '
                                f'see {self.children[name].log}')
            time.sleep(0.05)

    def stop(self, last: Sequence[str] = ('recorder',)) -> list[str]:
        """
        Stop all children: SIGINT, then after `STOP_SECONDS` SIGKILL; those in `last` at the end.

        Returns:
            Names of those that had to be killed.
        """
        deadline = time.monotonic() + STOP_SECONDS
        first = [child for name, child in self.children.items() if name not in last]
        then = [child for name, child in self.children.items() if name in last]
        killed = []
        for group, until in ((first, deadline - 0.7 if then else deadline), (then, deadline)):
            for child in group:
                child.signal(signal.SIGINT)
            for child in group:
                try:
                    child.process.wait(max(0.05, until - time.monotonic()))
                except subprocess.TimeoutExpired:
                    if group is then:
                        child.signal(signal.SIGKILL)
                        killed.append(child.name)
        for child in first:
            try:
                child.process.wait(max(0.05, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.signal(signal.SIGKILL)
                killed.append(child.name)
        for child in self.children.values():
            child.process.wait()
        return killed
