# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A `carracing` command in a process of its own, started in no time, and how it ended.

The processes are forks of one that has everything imported, because hundreds of commands are run
and an import of all libraries takes longer than most of them.
"""
from __future__ import annotations

import dataclasses
import faulthandler
import multiprocessing
import os
from pathlib import Path
import resource
import signal
import sys
import time

CODES = (0, 1, 2, 130)
"""Exit codes that a command may have."""

LONGEST_LINE = 500
"""Characters that a line may have."""

MOST_BYTES = 6 << 30

# torch's optimizers import _dynamo, which takes seconds
PRELOADED = (
    'torch._dynamo', 'faults.command_process', 'carracing_dqn.bringup.command', 'bags.command',
    'bags.verify', 'bags.recover', 'bags.info', 'carracing_dqn.bringup.train_command',
    'carracing_dqn.bringup.train_from_bag', 'carracing_dqn.bringup.evaluate_command')


@dataclasses.dataclass
class Ended:
    """
    How a command ended.

    Attributes:
        code: exit code, negative for a signal, None when it had to be killed.
        seconds: how long it took.
        text: everything it said.
        mib: most memory that it had.
    """

    code: int | None
    seconds: float
    text: str
    mib: float

    @property
    def last_line(self) -> str:
        """Return the last thing said."""
        lines = self.text.strip().splitlines()
        return lines[-1] if lines else ''

    def problems(self) -> list[str]:
        """Return what is wrong with any command that ends so."""
        problems = []
        lines = self.text.splitlines()
        if self.code is None:
            problems.append(f'hung for {self.seconds:.0f} s')
        elif self.code not in CODES:
            problems.append(f'ended with {self.code}')
        if 'Traceback' in self.text:
            problems.append(f'traceback: {self.last_line[:150]}')
        elif self.code == 2 and not any('error: ' in line for line in lines):
            problems.append(f'code 2 without an error line: {self.last_line[:150]}')
        if sum(line.startswith('error: ') for line in lines) > 1:
            problems.append('more than one error line')
        if max(map(len, lines), default=0) > LONGEST_LINE:
            problems.append(f'a line of {max(map(len, lines))} characters')
        if '\x1b' in self.text:
            problems.append('an escape sequence in what it said')
        return problems


def _child(words: tuple[str, ...], folder: str, output: str) -> None:
    os.setsid()
    file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for number in (1, 2):
        os.dup2(file, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chdir(folder)
    # what reads without end must not take the machine with it
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    faulthandler.enable()
    from carracing_dqn.bringup.command import main
    sys.argv = ['carracing', *words]
    try:
        code = main(list(words))
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:
        import traceback
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    Path(f'{output}.memory').write_text(str(memory))
    os._exit(code or 0)


def run_command(words: tuple[str, ...], folder: Path, *, seconds: float) -> Ended:
    """Run `carracing WORDS` in a folder; it is killed after some seconds."""
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload(list(PRELOADED))
    output = folder / 'said.txt'
    (folder / 'said.txt.memory').unlink(missing_ok=True)
    began = time.monotonic()
    process = context.Process(target=_child, args=(tuple(words), str(folder), str(output)))
    process.start()
    process.join(seconds)
    code = process.exitcode
    if code is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
    taken = time.monotonic() - began
    text = output.read_text(errors='replace') if output.exists() else ''
    memory = folder / 'said.txt.memory'
    mib = float(memory.read_text()) / 1024 if memory.exists() else 0.0
    return Ended(code, taken, text, mib)
