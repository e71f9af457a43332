# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What one topic does between two nodes: hand on, or a kind of fault for some seconds."""
from __future__ import annotations

from collections import deque
from random import Random

from faults.message_faults import garbage, wrong

PASS = 'pass'

KINDS = {
    'off': 'nothing comes through',
    'stuck': 'the same message again and again in place of each',
    'garbage': 'random bytes, or random values of the right type, before or in place of a message',
    'wrong': 'a well-formed message with odd stamps, sizes, encodings, names or values',
    'slow': 'two messages a second, the others are lost',
    'delayed': 'everything comes 0.3 s late',
    'duplicated': 'everything comes two to four times',
    'reordered': 'up to eight messages are gathered for 50 ms and come in another order',
    'intermittent': 'nothing for 0.3 s, everything for 0.3 s',
    'flooding': 'beside the true ones thousands a second, half of them with odd stamps',
}

SLOW_SECONDS = 0.5
DELAY_SECONDS = 0.3
GATHER = 8
GATHER_SECONDS = 0.05
BLINK_SECONDS = 0.3
# share of messages that are replaced rather than preceded by a bad one
REPLACED = 0.1
FLOOD_BATCH = 100
FLOOD_SECONDS = 0.01
# messages of one flood, by size: at most this many, and this many bytes
FLOOD_MESSAGES = 60_000
FLOOD_BYTES = 600 << 20


class Relay:
    """
    One topic between who publishes it and who subscribes to it; all times in seconds.

    Attributes:
        kind: the fault that is on, or `PASS`.
        taken, sent: messages that came and that were handed on.
    """

    def __init__(self, type_name: str) -> None:
        """Hand on until a fault is begun."""
        self.type_name = type_name
        self.kind = PASS
        self.taken = self.sent = 0
        self._random = Random(0)
        self._ends = 0.0
        self._last: bytes | None = None
        self._reset(0.0)

    def begin(self, kind: str, seconds: float, seed: int, now: float) -> None:
        """
        Begin a fault that ends by itself.

        Raises:
            KeyError: there is no such kind.
        """
        if kind != PASS:
            KINDS[kind]
        self.kind = kind
        self._random = Random(seed)
        self._ends = now + seconds
        self._reset(now)

    def _reset(self, now: float) -> None:
        self._began = self._passed = self._flooded = now
        self._kept: deque[tuple[float, bytes]] = deque()
        self._flood = 0

    def arrived(self, data: bytes, now: float) -> list[bytes]:
        """Take a message; return what is handed on at once."""
        self.taken += 1
        out = getattr(self, f'_{self.kind}')(data, now)
        self._last = data
        self.sent += len(out)
        return out

    def due(self, now: float) -> list[bytes]:
        """Return what time alone brings; called often."""
        out = []
        if self.kind == 'delayed':
            while self._kept and self._kept[0][0] + DELAY_SECONDS <= now:
                out.append(self._kept.popleft()[1])
        elif self.kind == 'reordered':
            if self._kept and self._kept[0][0] + GATHER_SECONDS <= now:
                out = self._shuffled()
        elif self.kind == 'flooding':
            out = self._more(now)
        if self.kind != PASS and now >= self._ends:
            # what was held is late, not lost
            out += [data for _, data in self._kept]
            self.kind = PASS
            self._kept.clear()
        self.sent += len(out)
        return out

    def _pass(self, data: bytes, now: float) -> list[bytes]:
        return [data]

    def _off(self, data: bytes, now: float) -> list[bytes]:
        return []

    def _stuck(self, data: bytes, now: float) -> list[bytes]:
        if not self._kept:
            self._kept.append((now, self._last or data))
        return [self._kept[0][1]]

    def _garbage(self, data: bytes, now: float) -> list[bytes]:
        return self._with(garbage(self.type_name, data, self._random), data)

    def _wrong(self, data: bytes, now: float) -> list[bytes]:
        return self._with(wrong(self.type_name, data, self._random), data)

    def _with(self, bad: bytes, data: bytes) -> list[bytes]:
        return [bad] if self._random.random() < REPLACED else [bad, data]

    def _slow(self, data: bytes, now: float) -> list[bytes]:
        if now - self._passed < SLOW_SECONDS:
            return []
        self._passed = now
        return [data]

    def _delayed(self, data: bytes, now: float) -> list[bytes]:
        self._kept.append((now, data))
        return []

    def _duplicated(self, data: bytes, now: float) -> list[bytes]:
        return [data] * self._random.randint(2, 4)

    def _reordered(self, data: bytes, now: float) -> list[bytes]:
        self._kept.append((now, data))
        return self._shuffled() if len(self._kept) >= GATHER else []

    def _shuffled(self) -> list[bytes]:
        out = [data for _, data in self._kept]
        self._random.shuffle(out)
        self._kept.clear()
        return out

    def _intermittent(self, data: bytes, now: float) -> list[bytes]:
        return [data] if int((now - self._began) / BLINK_SECONDS) % 2 else []

    def _flooding(self, data: bytes, now: float) -> list[bytes]:
        return [data]

    def _more(self, now: float) -> list[bytes]:
        if self._last is None or now - self._flooded < FLOOD_SECONDS:
            return []
        self._flooded = now
        room = min(FLOOD_MESSAGES, FLOOD_BYTES // max(1, len(self._last))) - self._flood
        batch = min(FLOOD_BATCH, room)
        self._flood += batch
        # a lie is costly to make, so half of a batch are copies of one
        lie = wrong(self.type_name, self._last, self._random)
        if len(lie) > 2 * len(self._last):
            lie = self._last
        return [self._random.choice((lie, self._last)) for _ in range(batch)]
