# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Wakes a thread as soon as a message has arrived, without an executor, where that can be done.

The middleware calls a function for each message that has arrived (`rcl`'s on-new-message
callback), in its receiving thread and without Python.
"""
from __future__ import annotations

import ctypes
import os
import select
import time
from typing import Any

from rclpy.subscription import Subscription

# A wait shorter than this is spent awake, for falling asleep and being woken takes about as long;
# but only if the last one was as short, so that a thread that waits for long burns nothing.
AWAKE_SECONDS = 250e-6


def _functions() -> tuple[Any, int] | None:
    """
    Return rcl's function that sets a callback and the address of eventfd_write.

    int eventfd_write(int, uint64_t), see eventfd(3), is also good as a callback that gets a
    number and a count of messages. None where there are no such symbols: another system, another
    C library, or a build of ROS in which rcl is no library of its own.
    """
    try:
        # rclpy has loaded it by now
        set_callback = ctypes.CDLL('librcl.so').rcl_subscription_set_on_new_message_callback
        write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p).value
    except (OSError, AttributeError):
        return None
    set_callback.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    set_callback.restype = ctypes.c_int
    return (set_callback, write) if hasattr(os, 'eventfd') else None


FUNCTIONS = _functions()


def call_on_arrival(
    subscription: Subscription, function: int | None, argument: int | None,
) -> bool:
    """
    Let the middleware call a C function for what arrives; None ends it.

    It runs in the receiving thread. The executor is not woken any more, so the subscription has
    to be a polled one.

    Args:
        subscription: the one to listen to.
        function: address of a `void (*)(void *argument, size_t messages)`.
        argument: its first argument.

    Returns:
        whether the middleware will do so.
    """
    if FUNCTIONS is None:
        return False
    set_callback, _ = FUNCTIONS
    with subscription.handle:
        return set_callback(subscription.handle.pointer, function, argument) == 0


class Bell:
    """
    Rings when a message arrives for one of its subscriptions.

    One ring may stand for several messages, and they may have been taken already: whoever has
    waited takes what there is.
    """

    def __init__(self) -> None:
        """Open the event counter; it stays open, for the middleware may still write to it."""
        self._awake = False
        if FUNCTIONS is None:
            return
        self._counter = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        poll = select.poll()
        poll.register(self._counter, select.POLLIN)
        self._poll = poll.poll

    def ring_for(self, subscription: Subscription) -> bool:
        """Ring for the messages of a polled subscription, too; return whether that is possible."""
        return FUNCTIONS is not None and call_on_arrival(
            subscription, FUNCTIONS[1], self._counter)

    def wait(self, until: float) -> None:
        """Wait for a ring, at most until a time of the monotonic clock."""
        began = now = time.monotonic()
        rung = self._poll(0)
        while self._awake and not rung and now - began < AWAKE_SECONDS:
            rung = self._poll(0)
            now = time.monotonic()
        if not rung and now < until:
            rung = self._poll(1000 * (until - now))
            now = time.monotonic()
        self._awake = bool(rung) and now - began < AWAKE_SECONDS
        if rung:
            os.eventfd_read(self._counter)
