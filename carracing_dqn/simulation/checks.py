# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a simulator, which anybody may have written, gives what it owes; one line if not."""
from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import contextlib
import math
import operator
from typing import Any

from msgs_bridge import blame
from msgs_bridge.errors import BridgeError, SimulatorError
from msgs_bridge.images import MAX_SIDE
from msgs_bridge.plain_text import plain
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.step import (
    EPISODE_CORE, MAX_NAME_LENGTH, MAX_NAMES, MAX_REWARD, STEP_CORE, STEP_INFO,
)
from msgs_bridge.twists import Command
import numpy as np

# simulated seconds of a frame
SHORTEST_FRAME, LONGEST_FRAME = 1e-6, 10.0
# constants and info, which travel together with `episode`
MOST_VALUES = MAX_NAMES - len({**EPISODE_CORE, **STEP_CORE, **STEP_INFO})


def blamed(name: str, what: str) -> contextlib.AbstractContextManager[None]:
    """Let the simulator of a name do something; what fails in it is a SimulatorError."""
    return blame.blamed(f'simulator {name[:100]!r}', what, SimulatorError)


@contextlib.contextmanager
def let_go_of(simulator: Any) -> Iterator[None]:
    """
    Close a simulator if what is tried with it fails.

    Nobody else would, and it may have started processes of its own. What is told is why it was
    closed, not what became of that.
    """
    try:
        yield
    except BaseException:
        with contextlib.suppress(Exception, SystemExit):
            simulator.close()
        raise


class Checks:
    """What a simulator does, before it is believed; errors are SimulatorErrors that name it."""

    def __init__(self, name: str) -> None:
        """Check the simulator of a name; nothing is known of it yet."""
        self._name = name[:100]
        self._shape: tuple[int, ...] | None = None
        self._names: tuple[str, ...] | None = None
        self._constants: tuple[str, ...] = ()
        self._failed = False

    def _refuse(self, what: str) -> SimulatorError:
        self._failed = True
        return SimulatorError(f'simulator {self._name!r} {what}')

    @contextlib.contextmanager
    def _blamed(self, what: str) -> Iterator[None]:
        """Do as `blamed` does, and remember that it has failed."""
        try:
            with blamed(self._name, what):
                yield
        except BridgeError:
            self._failed = True
            raise

    def frame_seconds(self, simulator: Simulator | type[Simulator]) -> float:
        """Return how long the frames of a simulator, or of all of a class, last."""
        seconds = getattr(simulator, 'frame_seconds', None)
        if not (_finite([seconds]) and SHORTEST_FRAME <= float(seconds) <= LONGEST_FRAME):
            raise self._refuse(f'has frame_seconds {_shown(seconds)}; accepted: '
                               f'{SHORTEST_FRAME:g} to {LONGEST_FRAME:g}')
        return float(seconds)

    def constants(self, simulator: Simulator) -> dict[str, float]:
        """Return its constants."""
        constants = getattr(simulator, 'constants', None)
        self._numbers('constant', constants, (*EPISODE_CORE, *STEP_INFO))
        self._constants = tuple(constants)
        return {name: float(value) for name, value in constants.items()}

    def reset(self, simulator: Simulator, seed: int | None) -> Outcome:
        """Reset it and return what came of it, as `advance` does."""
        with self._blamed('reset'):
            return self._outcome(simulator.reset(seed), 0)

    def advance(
        self, simulator: Simulator, command: Command, frames: int = 1, *, draw: bool = True,
    ) -> Outcome:
        """
        Drive it and return what came of it; `draw` as `Simulator.draws_on_request` says.

        Numbers are Python's and pixels an array of their own: sums of a simulator's float32 would
        be float32, and an array that it draws into again would change behind whoever keeps it.
        """
        with self._blamed('advance'):
            outcome = (simulator.advance(command, frames) if draw
                       else simulator.advance(command, frames, draw=False))
            # objects of somebody's may raise when they are looked at, too
            return self._outcome(outcome, frames, draw=draw)

    def skip(self, simulator: Simulator, episodes: int, seed: int | None) -> None:
        """Let it go past some resets."""
        with self._blamed('skip'):
            simulator.skip(episodes, seed)

    def close(self, simulator: Simulator) -> None:
        """Let go of it; raises SimulatorError where it cannot, unless it has failed before."""
        with contextlib.ExitStack() as stack:
            if self._failed:
                # in what says more: a simulator that is gone cannot be closed either
                stack.enter_context(contextlib.suppress(BridgeError))
            stack.enter_context(blamed(self._name, 'close'))
            simulator.close()

    def episode_return(self, total: float) -> None:
        """Raise SimulatorError for a sum of rewards that nobody would read."""
        if abs(total) > MAX_REWARD:
            raise self._refuse(f'gives rewards that add up to {total:g}; accepted: up to '
                               f'{MAX_REWARD:g}')

    def _outcome(self, outcome: Outcome, frames: int, *, draw: bool = True) -> Outcome:
        """Return an outcome as `advance` says; raise SimulatorError unless it is one."""
        if not isinstance(outcome, Outcome):
            raise self._refuse(f'gives a {type(outcome).__name__}; expected an Outcome')
        if draw:
            self._pixels(outcome.pixels)
        if not _finite([outcome.reward]) or abs(float(outcome.reward)) > MAX_REWARD:
            raise self._refuse(f'gives the reward {_shown(outcome.reward)}; accepted: a number of '
                               f'up to {MAX_REWARD:g}')
        for what in ('terminated', 'truncated'):
            if not _finite([getattr(outcome, what)]):
                raise self._refuse(f'gives {what} {_shown(getattr(outcome, what))}; expected true '
                                   'or false')
        passed = _whole(outcome.frames)
        if passed is None or not 0 <= passed <= frames or passed == 0 < frames:
            raise self._refuse(
                f'says that {_shown(outcome.frames)} frames passed; asked for {frames}')
        info = outcome.info
        if not (isinstance(info, Mapping) and tuple(info) == self._names
                and _finite(info.values())):
            self._numbers('info', info, (
                *STEP_CORE, *STEP_INFO, *EPISODE_CORE, *self._constants))
            if self._names is not None and set(info) != set(self._names):
                differing = sorted(set(info) ^ set(self._names))[0]
                raise self._refuse(f'gives the info {differing!r} now and then; expected: always')
            self._names = tuple(info)
        return Outcome(
            np.array(outcome.pixels) if draw else outcome.pixels, float(outcome.reward),
            bool(outcome.terminated), bool(outcome.truncated),
            {name: float(value) for name, value in info.items()}, passed)

    def _pixels(self, pixels: Any) -> None:
        shape = getattr(pixels, 'shape', None)
        if shape != self._shape or not isinstance(pixels, np.ndarray):
            self._first_pixels(pixels)
        if pixels.dtype != np.uint8:
            raise self._refuse(f'gives pixels of {pixels.dtype}; expected uint8')

    def _first_pixels(self, pixels: Any) -> None:
        if not (isinstance(pixels, np.ndarray) and pixels.ndim == 3 and pixels.shape[2] == 3
                and min(pixels.shape) > 0 and max(pixels.shape) <= MAX_SIDE):
            given = pixels.shape if isinstance(pixels, np.ndarray) else type(pixels).__name__
            raise self._refuse(
                f'gives pixels of {given}; expected an array (H, W, 3) of up to {MAX_SIDE} a side')
        if self._shape is not None:
            raise self._refuse(f'gives pixels of {pixels.shape}; expected {self._shape} as before')
        self._shape = pixels.shape

    def _numbers(self, what: str, values: Mapping[str, float], taken: tuple[str, ...]) -> None:
        if not isinstance(values, Mapping):
            raise self._refuse(f'has as {what} {_shown(values)}; expected names and numbers')
        count = len(self._constants) + len(values)
        if count > MOST_VALUES:
            raise self._refuse(f'has {count} values; accepted: up to {MOST_VALUES}, constants and '
                               'info together')
        for name, value in values.items():
            if not isinstance(name, str) or plain(name, MAX_NAME_LENGTH) != name:
                raise self._refuse(f'has an {what} {_shown(name)!r}; expected a name of up to '
                                   f'{MAX_NAME_LENGTH} letters')
            if name in taken:
                raise self._refuse(f'has an {what} {name!r}, which means something else')
            if not _finite([value]):
                raise self._refuse(f'has {what} {name!r} {_shown(value)}; expected a number')


def _finite(values: Iterable[Any]) -> bool:
    try:
        return all(map(math.isfinite, values))
    except Exception:
        # a number of 400 digits is an OverflowError, and an object of somebody's anything
        return False


def _whole(value: Any) -> int | None:
    """Return a whole number of any library as Python's; None: it is none."""
    try:
        return operator.index(value)
    except Exception:
        return None


def _shown(value: object) -> str:
    """Return what was given as a text; Python writes no number of thousands of digits."""
    try:
        return plain(value)
    except Exception:
        return f'of type {type(value).__name__}'
