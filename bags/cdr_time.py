# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The time that a serialized message begins with: a clock's, or that of a header."""
from __future__ import annotations

import struct

from msgs_bridge.stamps import NANOSECONDS

# four bytes of encapsulation, the second of which says in which order the bytes are
LITTLE, BIG = struct.Struct('<4xiI'), struct.Struct('>4xiI')


def first_time(data: bytes) -> int | None:
    """Return the time in ns at the start of a message; None if it is too short for one."""
    if len(data) < LITTLE.size:
        return None
    seconds, nanoseconds = (LITTLE if data[1] & 1 else BIG).unpack_from(data)
    return seconds * NANOSECONDS + nanoseconds
