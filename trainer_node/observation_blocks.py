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

from pathlib import Path
import re

import numpy as np
import safetensors
from safetensors.numpy import save

from msgs_bridge.atomic_write import write_bytes
from trainer_node.errors import RunError
from trainer_node.replay_buffer import ReplayBuffer

BLOCK = 4096
"""Slots in a file; with 48x48 observations 9 MB, some ten seconds of driving."""

_NAME = re.compile(r'observations-(\d{9})\.safetensors')


class ObservationBlocks:
    """The block files of one run."""

    def __init__(self, folder: Path) -> None:
        """Keep blocks in a folder that exists."""
        self.folder = folder

    def path(self, block: int) -> Path:
        """Return the file of a block, which holds slots block * BLOCK and on."""
        return self.folder / f'observations-{block:09d}.safetensors'

    def write(self, buffer: ReplayBuffer) -> np.ndarray:
        """
        Write the full blocks that are not on the disk yet.

        Returns:
            The observations that fill no block yet, uint8 (N, H, W), for the checkpoint.

        Raises:
            OSError: the disk is full or the folder cannot be written.
        """
        full = buffer.written // BLOCK
        for block in range(buffer.oldest // BLOCK, full):
            if not self.path(block).exists():
                observations = buffer.observations(block * BLOCK, (block + 1) * BLOCK)
                write_bytes(self.path(block), save({'observations': observations}))
        return buffer.observations(max(full * BLOCK, buffer.oldest), buffer.written)

    def remove_unneeded(self, buffer: ReplayBuffer) -> None:
        """
        Remove the blocks that are not of this buffer.

        They lie before its oldest observation, or after its last full block: those were written
        for a checkpoint that was never finished, and what comes next is something else.
        """
        needed = range(buffer.oldest // BLOCK, buffer.written // BLOCK)
        for path in self.folder.glob('observations-*.safetensors'):
            found = _NAME.fullmatch(path.name)
            if found and int(found[1]) not in needed:
                path.unlink(missing_ok=True)

    def read(self, buffer: ReplayBuffer, left_over: np.ndarray) -> None:
        """
        Put the observations of a checkpoint into a buffer that knows how much was written.

        Args:
            buffer: with everything but its observations.
            left_over: what `write` returned.

        Raises:
            RunError: a block is missing or damaged, or is not of the buffer's observation size.
        """
        full = buffer.written // BLOCK
        for block in range(buffer.oldest // BLOCK, full):
            path = self.path(block)
            try:
                with safetensors.safe_open(path, 'np') as file:
                    observations = file.get_tensor('observations')
                buffer.put_observations(block * BLOCK, observations[:BLOCK])
            except (safetensors.SafetensorError, OSError, ValueError) as error:
                raise RunError(f'{path}: damaged checkpoint: {error}') from None
            if len(observations) != BLOCK:
                raise RunError(f'{path}: damaged checkpoint: {len(observations)} observations, '
                               f'not {BLOCK}')
        buffer.put_observations(max(full * BLOCK, buffer.oldest), left_over)
        self.remove_unneeded(buffer)
