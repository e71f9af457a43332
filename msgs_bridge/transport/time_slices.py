# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Lets a process that others wait for have its core back at once."""
from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import struct

# What the scheduler gives a thread in one go. Linux does not interrupt whoever runs before its
# slice is used up (3 ms on two cores, however low its priority), except for a thread whose own
# slice is shorter.
SLICE_NANOSECONDS = 100_000

# number of sched_setattr(2), for which older C libraries have no function
_SCHED_SETATTR = {'x86_64': 314, 'aarch64': 274}
# struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period, two clamps
_ATTRIBUTES = struct.Struct('IIQiIQQQII')


def shorten_time_slices() -> None:
    """
    Give all threads of this process short time slices, at the priority they have.

    Linux 6.12 and later; it does nothing where that is not known or not allowed, nor to threads
    for which somebody has chosen another scheduling policy.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return
    call = ctypes.CDLL(None).syscall
    for thread in map(int, os.listdir('/proc/self/task')):
        # a thread may end meanwhile
        with contextlib.suppress(ProcessLookupError):
            if os.sched_getscheduler(thread) == os.SCHED_OTHER:
                nice = os.getpriority(os.PRIO_PROCESS, thread)
                attributes = _ATTRIBUTES.pack(
                    _ATTRIBUTES.size, os.SCHED_OTHER, 0, nice, 0, SLICE_NANOSECONDS, 0, 0, 0, 0)
                call(ctypes.c_long(number), ctypes.c_long(thread), attributes, ctypes.c_long(0))
