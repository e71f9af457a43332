# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Lets messages gather in DDS before its receiving thread handles them, as network cards do.

A message that finds the receiving thread asleep wakes it: a system call for the publisher, two
changes of task for the machine. At 10,000 messages a second that costs a lockstep run more than
the recorder's own work. So here the thread that was woken waits a little, and meanwhile messages
are only queued, which wakes nobody.

The middleware calls a function for each message that has arrived (`rcl`'s on-new-message
callback). It runs in the receiving thread, without Python, so it is compiled.
"""
from __future__ import annotations

from msgs_bridge.transport.arrival import call_on_arrival
from numba import carray, cfunc, types
import numpy as np
from rclpy.subscription import Subscription

# How long messages gather. Shared memory holds some 18 images of 96x96 a publisher until they
# are read; at 2,000 decisions/s four of them come meanwhile.
GATHER_MICROSECONDS = 2000
# A thread that had to wait for a lock looks as one that had slept; several such waits in a row
# must not hold up what has arrived already.
LEAST_BETWEEN = 8

# getrusage(2) on 64-bit Linux fills 18 words; the 17th counts how often the thread went to sleep
_USAGE_WORDS, _SLEEPS, _THIS_THREAD = 18, 16, 1
# after them, for each thread seen: who it is, its sleeps at its last gathering, messages since
_SLOT, _THREADS = 3, 8
_WORDS = _USAGE_WORDS + _SLOT * _THREADS
# written by the receiving threads as long as the process lives
_memory = np.zeros(_WORDS, np.int64)

_getrusage = types.ExternalFunction('getrusage', types.intc(types.intc, types.voidptr))
_usleep = types.ExternalFunction('usleep', types.intc(types.uintc))
_pthread_self = types.ExternalFunction('pthread_self', types.int64())


@cfunc(types.void(types.voidptr, types.uintp))
def _gather(memory, _):
    """Wait if this thread has slept since it last waited, so that messages gather."""
    words = carray(memory, _WORDS, np.int64)
    me = _pthread_self()
    slot = _USAGE_WORDS
    while words[slot] != me:
        if words[slot] == 0:
            words[slot] = me
        else:
            slot += _SLOT
            if slot == _WORDS:
                return
    words[slot + 2] += 1
    if words[slot + 2] < LEAST_BETWEEN:
        return
    _getrusage(_THIS_THREAD, memory)
    if words[_SLEEPS] != words[slot + 1]:
        _usleep(GATHER_MICROSECONDS)
        _getrusage(_THIS_THREAD, memory)
        words[slot + 1] = words[_SLEEPS]
        words[slot + 2] = 0


def gather_arrivals(subscription: Subscription, *, gather: bool) -> None:
    """
    Let what arrives for a subscription gather for up to 2 ms, or handle each at once again.

    Reception times are late by as much, and so is everything else that the process hears on
    topics and services. It wants a polled subscription: the executor would not be woken. Where
    the middleware cannot do that, recording only costs more.
    """
    call_on_arrival(subscription, *(
        (_gather.address, _memory.ctypes.data) if gather else (None, None)))
