# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Compression of chunks: none, lz4 or zstd, and unpacking that cannot be made to explode."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lz4.frame
import zstandard

from bags.errors import BagError
from bags.mcap_records import MAX_CHUNK

# name for the user -> name in the file
COMPRESSIONS = {'none': '', 'lz4': 'lz4', 'zstd': 'zstd'}
# frames of flat colours: level 1 packs nearly as well as 3 in half the time
ZSTD_LEVEL = 1
# A byte of lz4 makes at most 255; the library allocates what it is told before it looks.
LZ4_RATIO = 255


def packer(name: str) -> Callable[[bytes], bytes]:
    """
    Return the function that packs a chunk.

    Raises:
        BagError: an unknown compression.
    """
    if name == 'none':
        return bytes
    if name == 'lz4':
        return lz4.frame.compress
    if name == 'zstd':
        return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress
    raise BagError(f'compression is {name!r}; accepted: {", ".join(COMPRESSIONS)}')


def unpack(compression: str, data: Any, size: int) -> Any:
    """
    Return the unpacked bytes of a chunk that says it unpacks to `size` bytes.

    Never makes more than `size` bytes, and refuses sizes above 256 MiB.

    Raises:
        BagError: unknown compression, damaged data, or a size that is not what it says.
    """
    if size > MAX_CHUNK:
        raise BagError(f'chunk says it unpacks to {size} bytes; accepted: {MAX_CHUNK}')
    try:
        if compression == '':
            unpacked = data
        elif compression == 'lz4':
            if size > LZ4_RATIO * len(data):
                raise BagError(f'chunk says {len(data)} bytes of lz4 unpack to {size}')
            # one byte more than promised is enough to see that there is more
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif compression == 'zstd':
            inside = zstandard.frame_content_size(data)
            if inside > size:
                raise BagError(f'chunk says {size} bytes but its zstd frame says {inside}')
            unpacked = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        else:
            raise BagError(f'chunk compression is {compression!r}; accepted: '
                           f'{", ".join(map(repr, COMPRESSIONS.values()))}')
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise BagError(f'chunk cannot be unpacked: {error}') from None
    if len(unpacked) != size:
        raise BagError(f'chunk says {size} bytes but unpacks to {len(unpacked)}')
    return unpacked


def unpack_message(data: bytes) -> bytes:
    """
    Return what a message holds that was packed by itself with zstd.

    Raises:
        BagError: damaged data, or data that do not say that they unpack to at most 256 MiB.
    """
    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise BagError(f'message cannot be unpacked: {error}') from None
    if not 0 <= size <= MAX_CHUNK:
        told = f'unpacks to {size} bytes' if size >= 0 else 'does not say its size'
        raise BagError(f'message {told}; accepted: {MAX_CHUNK}')
    return unpack('zstd', data, size)
