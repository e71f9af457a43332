# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag or a live graph in Rerun (the extra `rerun`)."""
from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bags.frames import recorded_frames
from bags.reader import BagReader
from carracing_dqn.watch.layouts import PLOTS
from carracing_dqn.watch.source import Source
from msgs_bridge.errors import BridgeError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import Q_VALUE_EXTRAS

APPLICATION = 'carracing_dqn'
LIVE_SECONDS = 0.1
LOOPBACK = '127.0.0.1'
START_SECONDS = 30.0


class Moment(NamedTuple):
    """A picture, uint8 (H, W, 3) or None, with the values of its stamp in ns."""

    stamp: int
    pixels: np.ndarray | None
    step: Mapping[str, float]
    q_values: Mapping[str, float]


def open_view(save: str | None) -> rr.RecordingStream:
    """Return where to show: a window, or a file; raises BridgeError."""
    view = rr.RecordingStream(APPLICATION)
    if save is None:
        view.connect_grpc(start_viewer()[1])
    else:
        view.save(save)
    view.send_blueprint(blueprint())
    return view


def start_viewer(*options: str) -> tuple[subprocess.Popen, str]:
    """
    Start a viewer that this host alone can reach; return it, and where it listens.

    `RecordingStream.spawn` would start one that listens on every interface.

    Raises:
        BridgeError: it does not come up.
    """
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    viewer = subprocess.Popen(
        [sys.executable, '-m', 'rerun', '--bind', LOOPBACK, '--port', str(port),
         '--expect-data-soon', *options],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline and viewer.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), 1.0):
            return viewer, f'rerun+http://{LOOPBACK}:{port}/proxy'
        time.sleep(0.1)
    end_viewer(viewer)
    raise BridgeError('the viewer of Rerun does not come up; `rerun` by itself says why, '
                      '--save FILE does without it')


def end_viewer(viewer: subprocess.Popen) -> None:
    """End a viewer; the process that was started has one of its own, which is the window."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()


def blueprint() -> rrb.Blueprint:
    """Return the layout: the picture, and the same plots as in the other layouts."""
    return rrb.Blueprint(rrb.Horizontal(
        rrb.Spatial2DView(origin='/camera', name='camera'),
        rrb.Vertical(
            *(rrb.TimeSeriesView(
                name=plot.title, contents=[f'/step/{name}' for name in plot.values])
              for plot in PLOTS),
            rrb.TimeSeriesView(name='Q-values', origin='/q_values')),
        column_shares=[2, 3]), collapse_panels=True)


def show(view: rr.RecordingStream, moments: Iterable[Moment]) -> int:
    """Show moments as they come; return how many there were."""
    shown = 0
    for moment in moments:
        view.set_time('stamp', duration=moment.stamp / NANOSECONDS)
        if moment.pixels is not None:
            view.log('camera', rr.Image(np.ascontiguousarray(moment.pixels)))
        for bundle, values in (('step', moment.step), ('q_values', moment.q_values)):
            for name, value in values.items():
                # in parts, so that nothing in a name is taken for a path
                view.log([bundle, name], rr.Scalars(value))
        shown += 1
    view.flush()
    return shown


def of_bag(reader: BagReader, namespace: str) -> Iterator[Moment]:
    """Yield the frames of a bag; raises BagError, MessageError."""
    for frame in recorded_frames(reader, namespace=namespace):
        yield Moment(frame.stamp, frame.pixels, frame.step.values(), {
            name: value for name, value in frame.q_values.items() if name not in Q_VALUE_EXTRAS})


def of_graph(source: Source, namespace: str | None) -> Iterator[Moment]:
    """Yield what is newest of a live graph, some times a second, for ever."""
    number = 0
    while True:
        time.sleep(LIVE_SECONDS)
        drive = source.state.drive(namespace)
        if drive is not None and drive.stamp not in (None, number):
            number = drive.stamp
            yield Moment(drive.stamp, drive.pixels, drive.step, dict(drive.actions))
