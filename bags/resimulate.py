# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Drives recorded commands through the simulator again and compares every frame.

What a recording says of an episode - the simulator, its constants, the seed, the command and the
number of simulated frames of every decision - is in its provenance, `episode` and `step`
messages; a deterministic simulator then must give the same frames, rewards, ends and info to the
last bit.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import dataclasses
import json
import math
from typing import Any

import numpy as np

from bags.episodes import episode_constants
from bags.errors import BagError
from bags.frames import recorded_frames, RecordedFrame
from bags.reader import BagReader
from bags.steps import decode_step, usable
from bags.topic_lookup import find_topic
from carracing_dqn.simulation import find_simulator
from carracing_dqn.simulation.registry import DEFAULT
from msgs_bridge.errors import BridgeError, MessageError, SimulatorError
from msgs_bridge.settings import describe, from_mapping
from msgs_bridge.simulator import Outcome, Simulator
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.topics import STEP
from msgs_bridge.twists import Command

# when the bag's provenance does not say
DEFAULT_SEED = 42
DEFAULT_MAX_FRAMES = 1000
MAX_NAMED = 10
# episodes of streams that are passed over, all together, to get to those that are in the bag
MAX_STREAM = 100_000


@dataclasses.dataclass
class Resimulation:
    """
    What came of driving a recording again.

    Attributes:
        episodes, frames: driven again.
        differing_frames: frames in which image, reward, an end or a value of info differed.
        differing_images, differing_rewards, differing_ends, differing_info: which it was.
        skipped: reason -> episodes that could not be driven again.
        missing_images: frames whose image is not in the bag; their other values are compared.
        rejected: `episode` messages that cannot be used. What else cannot is passed over, and
            counted where transitions are joined.
        partings: the first frame of each episode that differed, in words.
    """

    episodes: int = 0
    frames: int = 0
    differing_frames: int = 0
    differing_images: int = 0
    differing_rewards: int = 0
    differing_ends: int = 0
    differing_info: int = 0
    missing_images: int = 0
    rejected: int = 0
    skipped: Counter[str] = dataclasses.field(default_factory=Counter)
    partings: list[str] = dataclasses.field(default_factory=list)


class Resimulator:
    """Drives the frames of one bag again; `result` says what came of it."""

    def __init__(
        self, reader: BagReader, *, namespace: str = '', simulator: str | None = None,
    ) -> None:
        """
        Read how the episodes of a bag were driven.

        Args:
            reader: the bag.
            namespace: where the topics of the car are; needed if there are several.
            simulator: name of an installed one, or module:Class; None takes what the bag names,
                if it is installed, for a name out of a file chooses no module.

        Raises:
            BagError: a damaged bag.
            SimulatorError: there is no such simulator.
        """
        self.result = Resimulation()
        self._reader = reader
        self._namespace = namespace
        self._given = _simulator_settings(reader)
        counts: Counter[str] = Counter()
        self._constants = episode_constants(reader, namespace=namespace, counts=counts)
        self.result.rejected = counts['rejected']
        named = simulator or self._given.get('simulator')
        name = str(named or DEFAULT)
        self._named = named is not None
        try:
            self._kind: type[Simulator] | None = find_simulator(
                name, registered_only=simulator is None)
        except SimulatorError:
            if simulator is not None:
                raise
            self._kind = None
        self._cannot = (
            f'its simulator {name[:60]!r} is none of the installed, and a bag has no say in what '
            'is imported; name it by --simulator'
            if self._kind is None else
            '' if self._kind.deterministic else f'simulator {name!r} is not deterministic')
        self._frame_limit = _frame_limit(reader, namespace)
        self._settings: Any = None
        self._simulator: Simulator | None = None
        self._stream_at: int | None = None
        self._may_pass_over = MAX_STREAM
        self._driving: int | None = None
        self._decision = 0
        self._steps = 0
        self._return = 0.0
        self._parted = False
        self._not_driven: set[int] = set()

    def run(self) -> Resimulation:
        """
        Drive everything again.

        Raises:
            BagError: a damaged bag, or one without images or steps.
            SimulatorError: the simulator cannot be made, or cannot go on.
        """
        for frame in recorded_frames(
                self._reader, namespace=self._namespace, with_q_values=False):
            try:
                self._take(frame)
            except (BagError, MessageError) as error:
                self._part(frame, str(error))
                self.result.differing_frames += 1
                self._leave(frame.step.episode)
        return self.result

    def _take(self, frame: RecordedFrame) -> None:
        number = frame.step.episode
        begins = frame.step.decision == 0
        if begins:
            # a simulator that was started again begins to count again
            self._not_driven.discard(number)
            self._parted = False
        elif number in self._not_driven:
            return
        if self._cannot:
            self._skip(number, self._cannot)
        elif begins:
            self._begin(frame, number)
        elif number == self._driving and frame.step.decision > self._decision + 1:
            # what was applied meanwhile is not known
            self._skip(number, 'steps of it are missing')
        elif number == self._driving:
            self._decision = frame.step.decision
            self._advance(frame)
        else:
            self._skip(number, 'begun before the recording')

    def _leave(self, number: int) -> None:
        """Drive nothing more of an episode: there is nothing to compare it with."""
        self._not_driven.add(number)
        self._driving = None

    def _skip(self, number: int, reason: str) -> None:
        self.result.skipped[reason] += 1
        self._leave(number)

    def _begin(self, frame: RecordedFrame, number: int) -> None:
        # the constants of version 0.1 stand in every step
        constants = self._constants.get(number, {})
        self._prepare({**frame.step.info, **constants})
        if not self._named and 'contract_version' in constants and (
                not self._simulator.constants.keys() <= constants.keys()):
            self._skip(number, 'the bag names no simulator; name it by --simulator')
            return
        if frame.step.seed >= 0:
            outcome = self._simulator.reset(frame.step.seed)
            self._stream_at = number
        elif not self._simulator.seeded:
            self._skip(number, 'its simulator takes no seeds')
            return
        else:
            outcome = self._reset_in_stream(number)
            if outcome is None:
                self._skip(number, f'more than {MAX_STREAM} episodes of its stream would have to '
                                   'be passed over')
                return
        self._driving = number
        self._decision = self._steps = 0
        self._return = 0.0
        self.result.episodes += 1
        self._compare(frame, outcome._replace(reward=0.0, terminated=False, truncated=False))

    def _prepare(self, constants: Mapping[str, float]) -> None:
        """Make the simulator with the settings that an episode was driven with."""
        values: dict[str, Any] = {}
        for name, (kind, default, _) in describe(self._kind.Settings).items():
            if kind is not str and math.isfinite(constants.get(name, math.nan)):
                values[name] = kind(constants[name])
            elif kind is not str and type(self._given.get(name)) is kind:
                values[name] = self._given[name]
            elif name == 'max_episode_frames':
                values[name] = self._frame_limit
            else:
                values[name] = default
        try:
            settings = from_mapping(self._kind.Settings, values)
            if settings != self._settings:
                self._simulator = self._kind(settings)
                self._settings, self._stream_at = settings, None
        except SimulatorError:
            # it may be this machine that has not what it needs
            raise
        except BridgeError as error:
            raise BagError(f'the simulator of the bag: {error}') from None

    def _reset_in_stream(self, number: int) -> Outcome | None:
        """Reset to episode `number` of the stream that the first seed began; None is too far."""
        seed = self._given.get('seed', DEFAULT_SEED)
        if type(seed) is not int or not 0 <= seed < 2**31:
            raise BagError(f'the bag was driven with seed {str(seed)[:40]}')
        goes_on = self._stream_at is not None and self._stream_at < number
        passed_over = number - self._stream_at - 1 if goes_on else number
        if passed_over > self._may_pass_over:
            return None
        self._may_pass_over -= passed_over
        if passed_over:
            self._simulator.skip(passed_over, None if goes_on else seed)
        self._stream_at = number
        return self._simulator.reset(None if number else seed)

    def _advance(self, frame: RecordedFrame) -> None:
        try:
            info = frame.step.info
            command = Command(*(info[name] for name in Command._fields))
            frames = int(info['frames'])
        except KeyError as error:
            raise MessageError(f'step lacks {error.args[0]!r}') from None
        if command != command.clamped():
            raise MessageError(f'{command} is beyond -1 to 1')
        # whatever a bag says, no episode of a simulator is longer than this
        outcome = self._simulator.advance(command, max(min(frames, DEFAULT_MAX_FRAMES * 50), 1))
        if outcome.frames != frames:
            self._part(frame, f'the recording goes on where the simulator ends (after '
                              f'{outcome.frames} of {frames} frames)')
            self.result.differing_frames += 1
        self._steps += outcome.frames
        # a simulator may count in numbers of NumPy, whose comparisons are none of Python's
        outcome = outcome._replace(reward=float(outcome.reward))
        self._return += outcome.reward
        if outcome.frames == frames:
            self._compare(frame, outcome)
        if outcome.terminated or outcome.truncated:
            self._driving = None
            if not frame.step.ended or outcome.frames != frames:
                self._leave(frame.step.episode)

    def _compare(self, frame: RecordedFrame, outcome: Outcome) -> None:
        result, step = self.result, frame.step
        result.frames += 1
        differences = []
        if frame.pixels is None:
            result.missing_images += 1
        elif not np.array_equal(frame.pixels, outcome.pixels):
            result.differing_images += 1
            differences.append('image')
        if step.reward != outcome.reward:
            result.differing_rewards += 1
            differences.append(f'reward {step.reward!r} instead of {outcome.reward!r}')
        ends = [name for name in ('terminated', 'truncated')
                if getattr(step, name) != bool(getattr(outcome, name))]
        expected = {**outcome.info, 'step': self._steps}
        wrong = [name for name, value in expected.items()
                 if name in step.info and step.info[name] != value]
        wrong += ['episode_return'] * (step.episode_return != self._return)
        result.differing_ends += bool(ends)
        result.differing_info += bool(wrong)
        differences += ends + wrong
        if differences:
            result.differing_frames += 1
            self._part(frame, ', '.join(differences))

    def _part(self, frame: RecordedFrame, what: str) -> None:
        """Say where recording and simulation part, once an episode."""
        if self._parted:
            return
        self._parted = True
        if len(self.result.partings) < MAX_NAMED:
            step = frame.step
            self.result.partings.append(
                f'episode {step.episode}, decision {step.decision}, step '
                f'message {frame.number}, simulation time {frame.stamp / NANOSECONDS:.2f} s: '
                f'{what}')


def _frame_limit(reader: BagReader, namespace: str) -> int:
    """Return after how many frames episodes were cut off, as most of those cut off show it."""
    name = find_topic(reader, STEP, namespace=namespace)
    limits: Counter[int] = Counter()
    messages = reader.messages([name]) if name else ()
    for _, (_, step) in usable(messages, lambda data: decode_step(data, name)):
        if step.truncated and not step.info.get('ended_early', 0):
            limits[int(step.info.get('step', step.decision))] += 1
    return limits.most_common(1)[0][0] if limits else DEFAULT_MAX_FRAMES


def _simulator_settings(reader: BagReader) -> dict[str, Any]:
    """Return the simulator's settings from the provenance, empty if it has none."""
    try:
        settings = json.loads(reader.custom_data.get('simulator', '{}'))
    except (ValueError, RecursionError):
        return {}
    return settings if isinstance(settings, dict) else {}
