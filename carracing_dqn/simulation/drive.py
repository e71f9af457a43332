# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes of any simulator one after the other on one clock: what its node says, without ROS."""
from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
import time
from typing import Any

import numpy as np

from carracing_dqn.simulation.checks import Checks, let_go_of
from carracing_dqn.simulation.registry import construct, DEFAULT
from carracing_dqn.simulation.settings import settings_for, SimulationSettings
from carracing_dqn.simulation.track_retries import TrackRetries
from msgs_bridge.errors import SimulatorError
from msgs_bridge.settings import from_mapping
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.step import CONTRACT_VERSION, MAX_SECONDS, Step
from msgs_bridge.twists import Command, STOP

# A gap that no camera makes between frames, so that a policy sees a new scene by stamps alone.
RESET_NANOSECONDS = NANOSECONDS
# episodes that are passed over at once, between two looks at the clock
SKIPPED_AT_ONCE = 16


@dataclasses.dataclass(frozen=True)
class Frame:
    """
    One published frame.

    Attributes:
        stamp: simulation time in ns.
        pixels: uint8 (H, W, 3) rgb.
        step: what goes out as `step`.
        episode: what goes out as `episode` on the first and the last frame of one, else None.
    """

    stamp: int
    pixels: np.ndarray
    step: Step
    episode: dict[str, float] | None


class Drive:
    """
    A series of episodes; `begin` starts the next one, `advance` drives one decision.

    Attributes:
        simulator: what is driven.
        settings: which episodes, and how many simulated frames to a published one.
        episode: number of the present episode, -1 before the first.
        seed: of the present episode; -1 when it came from the stream, or is none.
        stamp: simulation time in ns; it never goes back.
        running: whether an episode has begun and not ended.
    """

    def __init__(self, simulator: Simulator, settings: SimulationSettings) -> None:
        """
        Take a simulator; nothing is driven yet.

        Raises:
            SimulatorError: its frames last no acceptable time, or its constants are no numbers.
        """
        self.simulator = simulator
        self.settings = settings
        self.episode = settings.first_episode - 1
        self.seed = -1
        self.stamp = 0
        self.running = False
        self._checks = Checks(settings.simulator)
        frame_seconds = self._checks.frame_seconds(simulator)
        self._frame_nanoseconds = round(frame_seconds * NANOSECONDS)
        # longer than the gap between two frames, however long those last
        self._reset_nanoseconds = max(
            RESET_NANOSECONDS, 2 * settings.action_repeat * self._frame_nanoseconds)
        self._constants = {
            'contract_version': float(CONTRACT_VERSION),
            'frame_seconds': frame_seconds,
            'action_repeat': float(settings.action_repeat),
            **self._checks.constants(simulator)}
        # of the episodes before the first, those that are still to be passed over
        self._to_skip = (
            settings.first_episode if simulator.seeded and not settings.seed_each_episode else 0)
        self._stream_seed: int | None = settings.seed
        self._retries = TrackRetries(settings.track_retries)
        # of the track that the next episode has again
        self._again: int | None = None
        self._decision = self._frames = self._unanswered = 0
        self._return = 0.0

    @property
    def finished(self) -> bool:
        """Return whether all episodes asked for have been begun."""
        wanted = self.settings.episodes
        return wanted > 0 and self.episode + 1 >= self.settings.first_episode + wanted

    @property
    def decision(self) -> int:
        """Return the number of the newest frame within its episode."""
        return self._decision

    def skip_for(self, seconds: float) -> int:
        """
        Pass over episodes before the first for some time; return how many are left.

        A stream has to go past every one of them, which may take long.
        """
        until = time.monotonic() + seconds
        while self._to_skip and time.monotonic() < until:
            count = min(self._to_skip, SKIPPED_AT_ONCE)
            self._checks.skip(self.simulator, count, self._stream_seed)
            self._to_skip -= count
            self._stream_seed = None
        return self._to_skip

    def begin(self) -> Frame:
        """
        Reset to the next episode and return its first frame.

        Raises:
            SimulatorError: what the simulator gives is none of what it owes, or its time has come
                to the end of what a stamp can say.
            BridgeError: what it raises on purpose.
        """
        self.skip_for(math.inf)
        self.episode += 1
        if not self.simulator.seeded:
            seed = None
        elif self.settings.seed_each_episode:
            seed = self.settings.seed + self.episode if self._again is None else self._again
        else:
            seed, self._stream_seed = self._stream_seed, None
        self._again, self.seed = None, -1 if seed is None else seed
        outcome = self._checks.reset(self.simulator, seed)
        self.running = True
        self._decision = self._frames = self._unanswered = 0
        self._return = 0.0
        self._let_pass(self._reset_nanoseconds)
        step = self._step(outcome._replace(reward=0.0, terminated=False, truncated=False),
                          STOP, None)
        return Frame(self.stamp, outcome.pixels, step, self._summary(step))

    def advance(self, command: Command, applied: int | None) -> Frame:
        """
        Drive one decision and return the frame that follows.

        Args:
            command: within [-1, 1].
            applied: stamp in ns of the twist it came from; None when there was none.

        Raises:
            SimulatorError: no episode is running, what the simulator gives is none of what it
                owes, or its time has come to the end of what a stamp can say.
            BridgeError: what it raises on purpose.
        """
        if not self.running:
            raise SimulatorError('no episode is running')
        outcome = self._checks.advance(self.simulator, command, self.settings.action_repeat)
        self._decision += 1
        self._frames += outcome.frames
        self._unanswered += applied is None
        self._return += outcome.reward
        self._checks.episode_return(self._return)
        self._let_pass(outcome.frames * self._frame_nanoseconds)
        step = self._step(outcome, command, applied)
        self._last = step
        if not step.ended:
            return Frame(self.stamp, outcome.pixels, step, None)
        self.running = False
        if self.settings.seed_each_episode and self._retries.again(self._return):
            self._again = self.seed
        return Frame(self.stamp, outcome.pixels, step, self._summary(step))

    def abandon(self) -> dict[str, float] | None:
        """End the running episode where it is; return what goes out as `episode`, if it ran."""
        if not self.running:
            return None
        self.running = False
        return {**self._summary(self._last), 'truncated': 1.0}

    def close(self) -> None:
        """Let go of the simulator; raises SimulatorError where it cannot, as `Checks.close`."""
        self._checks.close(self.simulator)

    def _let_pass(self, nanoseconds: int) -> None:
        self.stamp += nanoseconds
        if self.stamp >= (MAX_SECONDS + 1) * NANOSECONDS:
            raise SimulatorError(
                f'simulated {MAX_SECONDS} s, after which no stamp of ROS can say the time: start '
                'anew, with first_episode to go on')

    def _step(self, outcome: Outcome, command: Command, applied: int | None) -> Step:
        step = self._last = Step(
            outcome.reward, bool(outcome.terminated), bool(outcome.truncated), self.episode,
            self._decision, self._return, self.seed, applied,
            {**outcome.info, 'step': self._frames, 'frames': outcome.frames,
             'linear': command.linear, 'angular': command.angular})
        return step

    def _summary(self, step: Step) -> dict[str, float]:
        """Return what `episode` says: the core, what the last step said, what is constant."""
        values = {
            'episode': self.episode, 'seed': self.seed, 'decisions': self._decision,
            'episode_return': self._return, 'terminated': step.terminated,
            'truncated': step.truncated, 'unanswered': self._unanswered, **step.info}
        # those are of the last decision alone
        for name in ('frames', 'linear', 'angular'):
            del values[name]
        return {**{name: float(value) for name, value in values.items()}, **self._constants}


def make_drive(settings: SimulationSettings) -> Drive:
    """
    Make the simulator that settings name, of which they are the settings, and its drive.

    Raises:
        SimulatorError: no such simulator, it cannot run here, or it owes something.
    """
    simulator = construct(settings.simulator, settings)
    with let_go_of(simulator):
        return Drive(simulator, settings)


def open_drive(values: Mapping[str, Any] | None = None) -> Drive:
    """
    Make a simulator and its drive from settings by name, as the node does from parameters.

    Raises:
        SimulatorError: no such simulator, or it cannot run here.
        SettingsError: a setting that is unknown or not accepted.
    """
    values = dict(values or {})
    name = values.get('simulator', DEFAULT)
    return make_drive(from_mapping(settings_for(name), values))
