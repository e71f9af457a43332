# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a race, lap by lap, and the words for it."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import dataclasses

from carracing_dqn.teleop.rivals import Rival
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import Step

MOST_RESULTS = 5
"""Laps behind that are shown."""


@dataclasses.dataclass(frozen=True)
class View:
    """
    What a window shows beside the picture.

    Attributes:
        title: which lap on which track.
        rows: name, value of the person, value of the model at the same time; '' for none.
        results: a line for each of the last laps.
        call: what is to be done, over the picture; '' while the lap goes on.
    """

    title: str
    rows: tuple[tuple[str, str, str], ...]
    results: tuple[str, ...]
    call: str


class Race:
    """
    The laps of a person, by the steps of the simulator.

    Attributes:
        started: whether the person has begun to drive the lap that waits.
        step: the newest one; None before the first.
    """

    def __init__(
        self, laps: int = 0, name: str = '', rivals: Mapping[int, Rival] | None = None,
    ) -> None:
        """
        Wait for the first lap.

        Args:
            laps: how many there will be; 0 = no end.
            name: of the model that is raced against.
            rivals: its laps by the seed of their track.
        """
        self._laps, self._name, self._rivals = laps, name, rivals or {}
        self.started = False
        self.step: Step | None = None
        self._first_stamp = self._stamp = 0
        self._first_episode: int | None = None
        self._results: deque[str] = deque(maxlen=MOST_RESULTS)

    def take(self, step: Step, stamp: int) -> None:
        """Take the next step, with its stamp in ns."""
        if self._first_episode is None or step.episode < self._first_episode:
            # a simulator that was started again counts anew
            self._first_episode = step.episode
        if step.decision == 0:
            self._first_stamp = stamp
        if step.decision == 0 or step.ended:
            self.started = False
        self.step, self._stamp = step, stamp
        if step.ended:
            self._results.append(self._result(step))

    @property
    def under_way(self) -> dict[str, float]:
        """Return how far a lap is that has begun and not ended, by name; empty without one."""
        step = self.step
        if step is None or step.ended or step.decision == 0:
            return {}
        return {'seed': step.seed, 'episode_return': step.episode_return,
                **{name: step.info[name] for name in ('step', 'tiles_visited', 'tiles_total')
                   if name in step.info}}

    @property
    def lap(self) -> int:
        """Return the number of the present lap, from 1; 0 before the first."""
        return 0 if self.step is None else self.step.episode - self._first_episode + 1

    def view(self) -> View:
        """Return what is to be shown now."""
        step = self.step
        if step is None:
            return View('waiting for the simulator', (), (), '')
        of = f' of {self._laps}' if self._laps else ''
        call = '' if self.started else (
            'end of the race' if step.ended and self.lap == self._laps else 'press gas to start')
        return View(f'lap {self.lap}{of}, track {step.seed}', tuple(self._rows(step)),
                    tuple(self._results), call)

    def _rows(self, step: Step) -> list[tuple[str, str, str]]:
        info, rival = step.info, self._rivals.get(step.seed)
        frames = int(info.get('step', 0))
        theirs, tiles = rival.at(frames) if rival else (0.0, 0)
        rows = [('', 'you', self._name if rival else ''),
                ('time', f'{(self._stamp - self._first_stamp) / NANOSECONDS:.2f} s', ''),
                ('return', f'{step.episode_return:.1f}', f'{theirs:.1f}' if rival else '')]
        if 'tiles_visited' in info:
            of = f'/{info["tiles_total"]:.0f}' if 'tiles_total' in info else ''
            rows.append(('tiles', f'{info["tiles_visited"]:.0f}{of}',
                         f'{tiles}{of}' if rival else ''))
            if rival and (gap := self._gap(rival, frames)):
                rows.append(('gap', gap, ''))
        if 'speed' in info:
            rows.append(('speed', f'{info["speed"]:.0f}', ''))
        return rows

    def _gap(self, rival: Rival, frames: int) -> str:
        """Return how long after the model the person came here, or before."""
        theirs = rival.frames_for(int(self.step.info['tiles_visited']))
        if theirs is None or not frames:
            return ''
        seconds = (self._stamp - self._first_stamp) / NANOSECONDS
        return f'{seconds - theirs * seconds / frames:+.2f} s'

    def _result(self, step: Step) -> str:
        rival = self._rivals.get(step.seed)
        against = f', {self._name} {rival.returns[-1]:.1f}' if rival else ''
        finished = ', finished' if step.info.get('lap_finished') else ''
        return f'track {step.seed}: {step.episode_return:.1f}{finished}{against}'
