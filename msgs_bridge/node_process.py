# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One node as a process: its arguments, its signals, its exit code and its end."""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import dataclasses
import gc
import inspect
import os
import signal
import sys
import threading
import time
import traceback
from typing import Any

from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.errors import BridgeError, SettingsError
from msgs_bridge.exit_codes import READER_GONE
from msgs_bridge.last_line import say
from msgs_bridge.log_callers import hide_folders
from msgs_bridge.plain_text import plain
from msgs_bridge.settings import text_table
from msgs_bridge.transport.time_slices import shorten_time_slices
import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import install_signal_handlers, SignalHandlerOptions
from rclpy.utilities import get_default_context, remove_ros_args

# How often the executor has its turn in a node with eager subscriptions. One turn takes 0.3 to
# 0.5 ms in rclpy, which is as long as the car needs for four frames.
EXECUTOR_SECONDS = 0.01

# What a node that ends by itself gives its subscribers: a busy machine may let them wait, and what
# a socket did not hold comes with the next heartbeat, every 0.2 s.
LAST_MESSAGES_SECONDS = 1.0
# what a node has that is told to end while it is still being made
PATIENCE_SECONDS = 10.0
# how often a node that has a last word looks whether a signal has come
LOOK_SECONDS = 0.05
# from a signal in the middle of a call of rclpy until rclpy knows of it
SHUTDOWN_SECONDS = 0.2

HELP = ('-h', '--help')
# characters of an error; paths may be long, and names from outside are in it
MAX_ERROR = 1000

FINISHED_TO = 'CARRACING_FINISHED_TO'
"""Environment variable: a file that is told the process id of a node whose work is done."""


class Finished(Exception):
    """Raised in a callback by a node whose work is done; see `Started.finished_code`."""


class HelpWanted(Exception):
    """Raised in place of a node when only its description is wanted."""

    def __init__(self, node_class: type, settings_classes: Sequence[type]) -> None:
        """Carry the class of the node and those of its parameters."""
        super().__init__()
        self.node_class, self.settings_classes = node_class, settings_classes


@dataclasses.dataclass
class Started:
    """
    How this process was started.

    Attributes:
        arguments: what followed the name of the program.
        describe_only: whether nodes are to raise `HelpWanted` instead of joining a graph.
        finished_code: exit code of a node whose work is done.
        stopped_code: exit code of a node that a signal has stopped. Both are 0, because launch
            calls everything else a death; who must tell one from the other, and from what a
            library ends with, sets others.
    """

    arguments: Sequence[str] = ()
    describe_only: bool = False
    finished_code: int = 0
    stopped_code: int = 0


STARTED = Started()


def run_node(make_node: Callable[[], Any], args: list[str] | None = None) -> int:
    """
    Run one node until SIGINT, SIGTERM, SIGHUP or shutdown, and end the process.

    `--help` describes it. A `BridgeError` while starting or running ends it with one line and
    code 2, an unexpected error with its traceback and code 1, anything else with code 0 (see
    `Started`).

    Args:
        make_node: makes a `NodeShell`.
        args: what follows the name of the program; None takes the process' own.
    """
    arguments = sys.argv[1:] if args is None else list(args)
    code = 0
    try:
        foreign = _foreign(arguments)
        if any(one in HELP for one in foreign):
            code = _print(node_help(make_node))
        elif foreign:
            raise SettingsError(
                f'unknown argument {plain(foreign[0])!r}; parameters go after --ros-args, as in '
                '--ros-args -p NAME:=VALUE; --help lists them')
        else:
            before_rclpy()
            hide_folders()
            STARTED.arguments = arguments
            finished = _spin_to_the_end(make_node, arguments)
            code = STARTED.finished_code if finished else STARTED.stopped_code
            if finished and FINISHED_TO in os.environ:
                with contextlib.suppress(OSError), open(os.environ[FINISHED_TO], 'a') as file:
                    file.write(f'{os.getpid()}\n')
    except BridgeError as error:
        say(f'error: {plain(error, MAX_ERROR)}')
        code = 2
    except rclpy_implementation.RCLError as error:
        # the machine lacks something, threads or memory
        say(f'error: ROS cannot go on: {plain(str(error).splitlines()[0], 300)}')
        code = 2
    except Exception:  # the process ends here, so this is where it is told
        traceback.print_exc()
        code = 1
    _leave(code)
    return code


def node_help(make_node: Callable[[], Any]) -> str:
    """Return purpose, topics and parameters of a node, without joining a graph."""
    STARTED.describe_only = True
    try:
        make_node()
        raise TypeError(f'{make_node} does not make a NodeShell')
    except HelpWanted as wanted:
        node_class, settings_classes = wanted.node_class, wanted.settings_classes
    finally:
        STARTED.describe_only = False
    texts = (node_class.__doc__, sys.modules[node_class.__module__].__doc__)
    purpose = next((text for text in texts if text and 'Purpose:' in text), texts[0] or '')
    tables = ''.join(map(text_table, settings_classes))
    return (f'{inspect.cleandoc(purpose)}\n\n'
            f'Parameters, set by --ros-args -p NAME:=VALUE:\n{tables}')


def _print(text: str) -> int:
    """Print a text and return the exit code; raises BridgeError where it cannot be written."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        return READER_GONE
    except OSError as error:
        raise BridgeError(f'standard output: {error.strerror}') from None
    return 0


def _foreign(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not for ROS."""
    with told_in_a_line('arguments for ROS'):
        return remove_ros_args(arguments)


@contextlib.contextmanager
def told_in_a_line(what: str) -> Iterator[None]:
    """Raise SettingsError for whatever ROS raises, which derives its errors from several bases."""
    try:
        yield
    except Exception as error:
        # the first line has the cause
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise SettingsError(f'{what}: {plain(lines[0], 300)}') from None


def _hear_signals(made: threading.Event) -> None:
    """
    End on SIGHUP, of a terminal that was closed, as on SIGTERM, unless it is ignored.

    Args:
        made: what a signal waits for, but not for ever: whether there is a node.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)

    def hear() -> None:
        while True:
            came = os.read(reader, 64)
            if signal.SIGHUP in came:
                os.kill(os.getpid(), signal.SIGTERM)
            if {signal.SIGINT, signal.SIGTERM} & {*came} and not made.wait(PATIENCE_SECONDS):
                say(f'error: told to end, and still starting {PATIENCE_SECONDS:g} s later')
                os._exit(2)

    # Python runs its own handlers between two of its instructions only, and the main thread waits
    # in the middleware; the number of the signal is written at once
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda *_: None)
    threading.Thread(target=hear, name='signals', daemon=True).start()


def _note_signals() -> Callable[[], bool]:
    """
    Keep SIGINT and SIGTERM from ending anything.

    Returns:
        what tells whether one has come. A second one ends whatever is being done.
    """
    came: list[int] = []

    def note(number: int, _: object) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, note)
    return lambda: bool(came)


def _spin_to_the_end(make_node: Callable[[], Any], arguments: list[str]) -> bool:
    """Run one node; return whether it has finished its work, and was not stopped by a signal."""
    on_interrupt = signal.getsignal(signal.SIGINT)
    # one that ended the making of a node would leave nobody to close what is open by then
    signalled, made, node = _note_signals(), threading.Event(), None
    _hear_signals(made)
    with told_in_a_line('ROS does not start'):
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = make_node()
        made.set()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if not node.has_last_word:
            signal.signal(signal.SIGINT, on_interrupt)
            install_signal_handlers()
        eager, wait = node.eager, LOOK_SECONDS if node.has_last_word else None
        if eager:
            shorten_time_slices()
            wait = 0
        while rclpy.ok() and not signalled():
            executor.spin_once(timeout_sec=wait)
            if eager:
                node.take_eagerly(EXECUTOR_SECONDS)
    except Finished:
        return True
    except (KeyboardInterrupt, ExternalShutdownException):
        # what the signal cut off half made, in the middle of a constructor of rclpy, cannot be
        # destroyed, and would say so with a traceback
        sys.unraisablehook = lambda _: None
    except Exception:
        # a signal in the middle of any call of rclpy makes it fail, sooner than rclpy knows of it
        time.sleep(SHUTDOWN_SECONDS)
        if rclpy.ok():
            raise
    finally:
        # what is left to do is bounded, and a second Ctrl-C must not cut off a save
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        made.set()
        if node is not None:
            node.close()
            _let_last_messages_arrive(node)
            node.destroy_node()
        rclpy.try_shutdown()
    return False


def _let_last_messages_arrive(node: Any) -> None:
    """Wait until subscribers have what was published, for it goes with its publisher."""
    deadline = time.monotonic() + LAST_MESSAGES_SECONDS
    for publisher in node.publishers:
        left = deadline - time.monotonic()
        # after a signal ROS is shut down, perhaps in the middle of this, and nothing can be waited
        # for any more
        with contextlib.suppress(Exception):
            if left > 0 and rclpy.ok():
                publisher.wait_for_all_acked(Duration(seconds=left))


def _leave(code: int) -> None:
    """
    End the process without unloading every library.

    Everything is saved and destroyed by now; taking down torch and DDS at the end of the
    interpreter was seen to take 2 of the 3 seconds in which a run has to stop.
    """
    get_default_context(shutting_down=True)
    # the context goes with its last reference, and the DDS participant with it
    gc.collect()
    for stream in (sys.stdout, sys.stderr):
        # what has nowhere to go has been told of, as far as there is anybody to tell
        with contextlib.suppress(OSError):
            stream.flush()
    os._exit(code)
