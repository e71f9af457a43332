# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Two hosts, which are network namespaces, and a wire that delays, loses and breaks."""
import contextlib
import ctypes
import fcntl
import heapq
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import threading
import time

import pytest

HERE, THERE = '10.78.0.1', '10.78.0.2'
# every "host" has mounts of its own, as long as this process of it lives
HOST = 'echo up && exec sleep infinity'
DEVICE = 'wire'
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454ca, 0x0002, 0x1000
CLONE_NEWNET = 0x40000000
FRAME = 2048


def ip(*words):
    return subprocess.run(['ip', *words], capture_output=True, text=True)


def open_tap(host):
    """Return a device in a namespace, as a file of its ethernet frames."""
    result = []

    def work():
        # of this thread alone, which ends
        with open(f'/run/netns/{host}', 'rb') as there:
            if ctypes.CDLL(None, use_errno=True).setns(there.fileno(), CLONE_NEWNET):
                result.append(OSError(ctypes.get_errno(), 'setns'))
                return
        try:
            tap = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            fcntl.ioctl(tap, TUNSETIFF, struct.pack('16sH22x', DEVICE.encode(),
                                                    IFF_TAP | IFF_NO_PI))
            result.append(tap)
        except OSError as error:
            result.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    if isinstance(result[0], OSError):
        raise result[0]
    return result[0]


class Wire:
    """
    Carries frames between two hosts, as `tc netem` would, which not every kernel has.

    Attributes:
        cut: whether it carries nothing.
        carried, lost: frames; bytes that were carried.
    """

    def __init__(self, hosts, *, delay=0.0, loss=0.0):
        """Delay every frame by some seconds and lose a share of them."""
        self.cut = False
        self.carried = self.lost = self.bytes = 0
        self._delay, self._loss = delay, loss
        self._taps = [open_tap(host) for host in hosts]
        self._random = random.Random(0)
        self._closing = False
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def _carry(self):
        poll = select.poll()
        for tap in self._taps:
            poll.register(tap, select.POLLIN)
        waiting, number = [], 0
        while not self._closing:
            now = time.monotonic()
            poll.poll(1 + 1000 * min(waiting[0][0] - now, 0.1) if waiting else 100)
            for tap, other in zip(self._taps, reversed(self._taps)):
                for _ in range(200):
                    try:
                        frame = os.read(tap, FRAME)
                    except BlockingIOError:
                        break
                    if self.cut or self._random.random() < self._loss:
                        self.lost += 1
                        continue
                    number += 1
                    heapq.heappush(waiting, (time.monotonic() + self._delay, number, other, frame))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, other, frame = heapq.heappop(waiting)
                # a full queue loses it, as anywhere
                with contextlib.suppress(BlockingIOError, OSError):
                    os.write(other, frame)
                    self.carried += 1
                    self.bytes += len(frame)

    def close(self):
        self._closing = True
        self._thread.join()
        for tap in self._taps:
            os.close(tap)


class Host:
    """One host: a network namespace, and mounts of its own."""

    def __init__(self, name):
        """Make the namespace; raises OSError."""
        if ip('netns', 'add', name).returncode:
            raise OSError('network namespaces are not allowed here')
        self.name = name
        self._holder = None

    def on(self, *command):
        """Return the command that runs another here."""
        if self._holder is None or self._holder.poll() is not None:
            self._holder = subprocess.Popen(
                ['ip', 'netns', 'exec', self.name, 'sh', '-c', HOST], stdout=subprocess.PIPE)
            assert self._holder.stdout.readline() == b'up\n'
        return ['nsenter', '-t', str(self._holder.pid), '-m', '-n', *command]

    def kill(self):
        """End every process of it at once, as when its power is gone."""
        for pid in ip('netns', 'pids', self.name).stdout.split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)
        if self._holder is not None:
            self._holder.wait()
            self._holder = None

    def remove(self):
        """Make it never to have been."""
        self.kill()
        ip('netns', 'del', self.name)


@contextlib.contextmanager
def two_hosts(**link):
    """Yield two hosts and the wire between them, or skip with the reason."""
    if os.geteuid() != 0 or not shutil.which('ip'):
        pytest.skip('needs root and iproute2 to make network namespaces')
    hosts, wire = [], None
    try:
        try:
            for side in 'ab':
                hosts.append(Host(f'cars{os.getpid()}{side}'))
            wire = Wire([host.name for host in hosts], **link)
        except OSError as error:
            pytest.skip(f'no two hosts to be had here: {error}')
        for host, address in zip(hosts, (HERE, THERE)):
            for words in (['addr', 'add', f'{address}/24', 'dev', DEVICE],
                          ['link', 'set', DEVICE, 'up'], ['link', 'set', 'lo', 'up'],
                          ['route', 'add', '224.0.0.0/4', 'dev', DEVICE]):
                assert not ip('-n', host.name, *words).returncode, words
        yield hosts, wire
    finally:
        for host in hosts:
            host.kill()
        if wire is not None:
            wire.close()
        for host in hosts:
            host.remove()
