# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A copy of a run that can be gone on with, small enough to be handed around.

    python -m trainer_node.without_replay RUN COPY

Networks, optimizer, schedules, counts and records are in it, and the replay is empty: a run that
goes on from there waits for `learning_starts` transitions, and for as many as the replay holds it
samples from fewer than the run before did. So it is no exact resume.
"""
from __future__ import annotations

import argparse
import os
from pathlib import Path
import shutil
import sys

from msgs_bridge.errors import BridgeError
from msgs_bridge.exit_codes import ERROR
from msgs_bridge.last_line import say
from msgs_bridge.plain_text import plain
from trainer_node.errors import RunError
from trainer_node.observation_blocks import is_block
from trainer_node.run_folder import RunFolder


def copy_without_replay(run: Path, copy: Path) -> None:
    """
    Copy a run folder, its replay left out.

    Raises:
        RunError: it is none, another process learns into it, or the copy cannot be written.
    """
    # on first use, because torch takes a second to load
    from trainer_node.training import Training
    folder = RunFolder(run)
    if not folder.checkpoint.is_file():
        raise RunError(f'{run} has no checkpoint')
    if run.resolve() in copy.resolve().parents:
        raise RunError(f'{copy} is inside of {run}')
    if copy.exists():
        raise RunError(f'{copy} exists already; nothing was overwritten')
    folder.lock()
    try:
        # blocks are read once, and never written again
        shutil.copytree(run, copy, copy_function=_link_blocks)
        training = Training.resume(copy, device='cpu')
        training.learning.forget_replay()
        training.save()
    except (OSError, BridgeError) as error:
        # half a copy is none
        shutil.rmtree(copy, ignore_errors=True)
        if isinstance(error, BridgeError):
            raise
        raise RunError(f'{copy} cannot be written: {error}') from None
    finally:
        folder.unlock()


def _link_blocks(source: str, target: str) -> str:
    if is_block(Path(source)):
        try:
            os.link(source, target)
            return target
        except OSError:
            # another file system
            pass
    return shutil.copy2(source, target)


def main(words: list[str] | None = None) -> int:
    """Copy; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('run', type=Path, help='run folder, which nobody learns into just now')
    parser.add_argument('copy', type=Path, help='folder to make')
    arguments = parser.parse_args(words)
    try:
        copy_without_replay(arguments.run, arguments.copy)
    except BridgeError as error:
        say(f'error: {plain(error, 1000)}')
        return ERROR
    return 0


if __name__ == '__main__':
    sys.exit(main())
