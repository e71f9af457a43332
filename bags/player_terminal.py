# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag that is played at a terminal: the place in it, and keys that act on it."""
from __future__ import annotations

from collections.abc import Callable
import time

from bags.live_line import clock_text, LiveLine
from bags.playback import NANOSECONDS, next_rate, Playback, SKIP_SECONDS
from msgs_bridge.terminal_keys import ARROWS, keys_in, LEFT, RIGHT, TerminalKeys

PAUSE, STEP, FASTER, SLOWER, QUIT = 'pause', 'step', 'faster', 'slower', 'quit'
KEYS = {**ARROWS, b' ': PAUSE, b's': STEP, b'+': FASTER, b'=': FASTER, b'-': SLOWER, b'q': QUIT}
HELP = f'space pause, ← → {SKIP_SECONDS:g} s, s step, + - speed, q end'
SHOW_SECONDS = 0.2


class PlayerTerminal:
    """
    Shows where a playback is, and lets a person act on it; does nothing without a terminal.

    A step lets one message through, as `~/step` does.

    Attributes:
        waiting: what it waits for before it plays, '' once it plays.
    """

    def __init__(
        self, playback: Playback, start: int, end: int, *,
        set_rate: Callable[[float], None], quit_: Callable[[], None],
    ) -> None:
        """
        Take the terminal.

        Args:
            playback: is acted on.
            start: time of the bag in ns from which it is played.
            end: and to which.
            set_rate: makes it go at another speed, 2 = twice as fast as recorded.
            quit_: ends it.
        """
        self._playback, self._start, self._end = playback, start, end
        self._set_rate, self._quit = set_rate, quit_
        self._keys, self._line = TerminalKeys(), LiveLine()
        self._show_at = 0.0
        self.waiting = ''

    def beat(self) -> None:
        """Act by the keys that were pressed since, and show the place."""
        pressed = keys_in(self._keys.read(), KEYS)
        for key in pressed:
            self._act(key)
        now = time.monotonic()
        if pressed or now >= self._show_at:
            self._show_at = now + SHOW_SECONDS
            self._line.show(self._text())

    def close(self) -> None:
        """Give the terminal back."""
        self._keys.close()
        self._line.close()

    def _act(self, key: str) -> None:
        playback = self._playback
        if key == PAUSE:
            playback.pause(not playback.paused)
        elif key == STEP:
            playback.pause(True)
            playback.step()
        elif key in (LEFT, RIGHT):
            place = playback.now + round((1 if key == RIGHT else -1) * SKIP_SECONDS * NANOSECONDS)
            playback.wind(min(max(place, self._start), self._end))
        elif key in (FASTER, SLOWER):
            self._set_rate(next_rate(playback.rate, 1 if key == FASTER else -1))
        elif key == QUIT:
            self._quit()

    def _text(self) -> str:
        playback = self._playback
        if self.waiting:
            return self.waiting
        place = max(playback.now - self._start, 0) / NANOSECONDS
        whole = (self._end - self._start) / NANOSECONDS
        speed = f'{playback.rate:g}x' if playback.rate else 'as fast as possible'
        state = 'paused' if playback.paused else 'held back' if playback.held else speed
        keys = f' | {HELP}' if self._keys.there else ''
        return f'{clock_text(place)} of {clock_text(whole)}, {state}{keys}'
