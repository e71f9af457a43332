# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps as whole nanoseconds: the join key of the graph."""

NANOSECONDS = 1_000_000_000


def to_nanoseconds(stamp: object) -> int:
    """Return a `builtin_interfaces/Time` as nanoseconds."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp: object, nanoseconds: int) -> None:
    """Write nanoseconds into a `builtin_interfaces/Time`."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)
