# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The pictures of the replay buffer on disk, in blocks that are written once.

A checkpoint of half a gigabyte takes seconds, and a run that is told to stop has only two. So
pictures are kept in files of `BLOCK` slots each: a checkpoint writes the blocks that were filled
since the one before, and what is left over goes into the checkpoint itself. Blocks that only an
older checkpoint needs are removed after the new one is in place.
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
"""Slots in a file; with 48x48 pictures 9 MB, some ten seconds of driving."""

_NAME = re.compile(r'pictures-(\d{9})\.safetensors')


class PictureBlocks:
    """The block files of one run."""

    def __init__(self, folder: Path) -> None:
        """Keep blocks in a folder that exists."""
        self.folder = folder

    def path(self, block: int) -> Path:
        """Return the file of a block, which holds slots block * BLOCK and on."""
        return self.folder / f'pictures-{block:09d}.safetensors'

    def write(self, buffer: ReplayBuffer) -> np.ndarray:
        """
        Write the full blocks that are not on the disk yet.

        Returns:
            The pictures that fill no block yet, uint8 (N, H, W), for the checkpoint.

        Raises:
            OSError: the disk is full or the folder cannot be written.
        """
        full = buffer.written // BLOCK
        for block in range(buffer.oldest // BLOCK, full):
            if not self.path(block).exists():
                pictures = buffer.pictures(block * BLOCK, (block + 1) * BLOCK)
                write_bytes(self.path(block), save({'pictures': pictures}))
        return buffer.pictures(max(full * BLOCK, buffer.oldest), buffer.written)

    def remove_unneeded(self, buffer: ReplayBuffer) -> None:
        """
        Remove the blocks that are not of this buffer.

        They lie before its oldest picture, or after its last full block: those were written for a
        checkpoint that was never finished, and what comes next is something else.
        """
        needed = range(buffer.oldest // BLOCK, buffer.written // BLOCK)
        for path in self.folder.glob('pictures-*.safetensors'):
            found = _NAME.fullmatch(path.name)
            if found and int(found[1]) not in needed:
                path.unlink(missing_ok=True)

    def read(self, buffer: ReplayBuffer, left_over: np.ndarray) -> None:
        """
        Put the pictures of a checkpoint into a buffer that knows how much was written.

        Args:
            buffer: with everything but its pictures.
            left_over: what `write` returned.

        Raises:
            RunError: a block is missing or damaged, or is not of the buffer's picture size.
        """
        full = buffer.written // BLOCK
        for block in range(buffer.oldest // BLOCK, full):
            path = self.path(block)
            try:
                with safetensors.safe_open(path, 'np') as file:
                    pictures = file.get_tensor('pictures')
                buffer.put_pictures(block * BLOCK, pictures[:BLOCK])
            except (safetensors.SafetensorError, OSError, ValueError) as error:
                raise RunError(f'{path}: damaged checkpoint: {error}') from None
            if len(pictures) != BLOCK:
                raise RunError(f'{path}: damaged checkpoint: {len(pictures)} pictures, '
                               f'not {BLOCK}')
        buffer.put_pictures(max(full * BLOCK, buffer.oldest), left_over)
        self.remove_unneeded(buffer)
