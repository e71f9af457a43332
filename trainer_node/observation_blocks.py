# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The observations of the replay buffer on disk, in blocks that are written once.

A checkpoint of half a gigabyte takes seconds, and a run that is told to stop has only two. So
observations are kept in files of `BLOCK` slots each: a checkpoint writes the blocks that were
filled since the one before, and what is left over goes into the checkpoint itself. Blocks that
only an older checkpoint needs are removed after the new one is in place.
"""
from __future__ import annotations

import hashlib
from pathlib import Path
import re
from typing import TYPE_CHECKING

import numpy as np
import safetensors
from safetensors.numpy import load, save

from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.regular_file import read_regular
from trainer_node.errors import RunError

if TYPE_CHECKING:
    from trainer_node.replay_buffer import ReplayBuffer

BLOCK = 4096
"""Slots in a file; with 48x48 observations 9 MB, some ten seconds of driving."""
HEADER_BYTES = 2**16
"""More than what stands before the observations in a file."""

_NAME = re.compile(r'observations-(\d{9})\.safetensors')


class ObservationBlocks:
    """
    The block files of one run.

    Attributes:
        checksums: SHA-256 of each block file that the next checkpoint needs, by its number.
    """

    def __init__(self, folder: Path) -> None:
        """Keep blocks in a folder that exists."""
        self.folder = folder
        self.checksums: dict[int, str] = {}

    def path(self, block: int) -> Path:
        """Return the file of a block, which holds slots block * BLOCK and on."""
        return self.folder / f'observations-{block:09d}.safetensors'

    def write(self, replay: ReplayBuffer) -> np.ndarray:
        """
        Write the full blocks that are not on the disk yet.

        Returns:
            The observations that fill no block yet, uint8 (N, H, W), for the checkpoint.

        Raises:
            OSError: the disk is full or the folder cannot be written.
        """
        full = replay.written // BLOCK
        for block in _needed(replay):
            if block not in self.checksums:
                data = save({'observations': replay.observations(
                    block * BLOCK, (block + 1) * BLOCK)})
                write_bytes(self.path(block), data)
                self.checksums[block] = hashlib.sha256(data).hexdigest()
        self.checksums = {block: self.checksums[block] for block in _needed(replay)}
        return replay.observations(max(full * BLOCK, replay.oldest), replay.written)

    def remove_unneeded(self, replay: ReplayBuffer) -> None:
        """
        Remove the blocks that are not of this buffer.

        They lie before its oldest observation, or after its last full block: those were written
        for a checkpoint that was never finished, and what comes next is something else.
        """
        needed = _needed(replay)
        for path in self.folder.glob('observations-*.safetensors'):
            found = _NAME.fullmatch(path.name)
            if found and int(found[1]) not in needed:
                path.unlink(missing_ok=True)

    def read(
        self, replay: ReplayBuffer, left_over: np.ndarray, checksums: dict[int, str],
    ) -> None:
        """
        Put the observations of a checkpoint into a buffer that knows how much was written.

        Args:
            replay: with everything but its observations.
            left_over: what `write` returned.
            checksums: what `checksums` was then.

        Raises:
            RunError: a block is missing or damaged, or is not of the buffer's observation size.
        """
        most = BLOCK * replay.observation_bytes + HEADER_BYTES
        for block in _needed(replay):
            path = self.path(block)
            data = read_regular(path, most, RunError)
            if hashlib.sha256(data).hexdigest() != checksums.get(block):
                raise RunError(f'{path}: damaged checkpoint: not the bytes that were written')
            try:
                observations = load(data)['observations']
                replay.put_observations(block * BLOCK, observations)
            except (safetensors.SafetensorError, KeyError, ValueError) as error:
                raise RunError(f'{path}: damaged checkpoint: {error}') from None
            if len(observations) != BLOCK:
                raise RunError(f'{path}: damaged checkpoint: {len(observations)} observations, '
                               f'not {BLOCK}')
        full = replay.written // BLOCK
        first = max(full * BLOCK, replay.oldest)
        if len(left_over) != replay.written - first:
            raise ValueError(f'{len(left_over)} observations after slot {first}; expected '
                             f'{replay.written - first}')
        replay.put_observations(first, left_over)
        self.checksums = {block: checksums[block] for block in _needed(replay)}


def is_block(path: Path) -> bool:
    """Return whether a file is a block, by its name."""
    return _NAME.fullmatch(path.name) is not None


def _needed(replay: ReplayBuffer) -> range:
    """Return the numbers of the full blocks that hold an observation of the buffer."""
    return range(replay.oldest // BLOCK, replay.written // BLOCK)
