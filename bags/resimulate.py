# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Drives recorded actions through the simulator again and compares every frame.

What a recording says of an episode - its seed, the variant, the action and the number of
simulator frames of every decision - is in its `step` bundles; the environment then must give the
same frames, rewards and flags to the last bit.
"""
from __future__ import annotations

from collections import Counter
import dataclasses
import json
from typing import Any

import numpy as np

from bags.errors import BagError
from bags.topic_lookup import find_topic
from bags.decode import BundleDecoder
from bags.frames import recorded_frames, RecordedFrame
from bags.reader import BagReader
from bags.steps import StepDecoder
from carracing_sim_node.controls import controls
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS
from msgs_bridge.topics import EPISODE, STEP
from msgs_bridge.twists import Command

# of carracing_sim_node, when the bag's provenance does not say
DEFAULT_SEED = 42
DEFAULT_MAX_FRAMES = 1000
MAX_NAMED = 10
# tracks of a stream that are laid one after the other to get to one, a millisecond each
MAX_STREAM = 100_000


@dataclasses.dataclass
class Resimulation:
    """
    What came of driving a recording again.

    Attributes:
        episodes, frames: driven again.
        differing_frames: frames in which image, reward, a flag or a fact differed.
        differing_images, differing_rewards, differing_flags, differing_facts: which it was.
        skipped: reason -> episodes that could not be driven again.
        missing_images: frames whose image is not in the bag; their other values are compared.
        partings: the first frame of each episode that differed, in words.
    """

    episodes: int = 0
    frames: int = 0
    differing_frames: int = 0
    differing_images: int = 0
    differing_rewards: int = 0
    differing_flags: int = 0
    differing_facts: int = 0
    missing_images: int = 0
    skipped: Counter[str] = dataclasses.field(default_factory=Counter)
    partings: list[str] = dataclasses.field(default_factory=list)


class Resimulator:
    """Drives the frames of one bag again; `result` says what came of it."""

    def __init__(self, reader: BagReader, *, namespace: str = '') -> None:
        """
        Read the seeds of a bag.

        Raises:
            BagError: a damaged bag.
        """
        self.result = Resimulation()
        self._reader = reader
        self._namespace = namespace
        self._simulator = _simulator_settings(reader)
        self._constants = _constants(reader, namespace)
        self._frame_limit = int(
            self._simulator.get('max_episode_frames') or _frame_limit(reader, namespace))
        self._variant: dict[str, Any] | None = None
        self._env: Any = None
        self._stream_at: int | None = None
        self._driving: int | None = None
        self._return = 0.0
        self._parted = False
        self._not_driven: set[int] = set()

    def run(self) -> Resimulation:
        """
        Drive everything again.

        Raises:
            BagError: a damaged bag, or one without images or steps.
            MessageError: a message that cannot be used.
        """
        for frame in recorded_frames(self._reader, namespace=self._namespace):
            number = frame.step.episode
            if frame.step.decision == 0:
                self._begin(frame, number)
            elif number == self._driving:
                self._advance(frame)
            elif number not in self._not_driven:
                self._skip(number, 'begun before the recording')
        return self.result

    def _skip(self, number: int, reason: str) -> None:
        self._not_driven.add(number)
        self.result.skipped[reason] += 1
        self._driving = None

    def _begin(self, frame: RecordedFrame, number: int) -> None:
        # those of version 0.1 stand in every step
        self._prepare({**frame.step.info, **self._constants.get(number, {})})
        seed = frame.step.seed
        if seed >= 0:
            pixels, _ = self._env.reset(seed=seed)
            self._stream_at = number
        else:
            pixels = self._reset_in_stream(number)
        self._driving = number
        self._return = 0.0
        self._parted = False
        self.result.episodes += 1
        self._compare(frame, pixels, 0.0, False, False, False)

    def _prepare(self, constants: dict[str, float]) -> None:
        """Make the environment of the variant that the constants of an episode name."""
        variant = {
            'zoom': constants.get('zoom', 1) > 0,
            'domain_randomize': constants.get('domain_randomize', 0) > 0,
            'early_end_frames': int(constants.get('early_end_frames', 0)),
            'early_end_lap': constants.get('early_end_lap', 0) > 0}
        if variant == self._variant:
            return
        # the simulator is needed for nothing else in this package
        from carracing_sim_node import make_env
        self._variant = variant
        self._env = make_env(**variant, max_episode_steps=self._frame_limit)
        self._stream_at = None

    def _reset_in_stream(self, number: int) -> np.ndarray:
        """Reset to track `number` of the stream of tracks that the first seed began."""
        if number > MAX_STREAM:
            raise BagError(f'episode {number} of a stream of tracks; accepted: up to '
                           f'{MAX_STREAM}')
        if self._stream_at is not None and self._stream_at < number:
            self._env.skip_episodes(number - self._stream_at - 1)
        elif number:
            self._env.skip_episodes(
                number, seed=int(self._simulator.get('seed', DEFAULT_SEED)))
        self._stream_at = number
        pixels, _ = self._env.reset()
        return pixels

    def _advance(self, frame: RecordedFrame) -> None:
        try:
            info = frame.step.info
            command = Command(*(info[name] for name in Command._fields))
            frames = int(info['frames'])
        except KeyError as error:
            raise MessageError(f'step lacks {error.args[0]!r}') from None
        if command != command.clamped():
            raise MessageError(f'{command} is beyond -1 to 1')
        action = controls(command)
        reward, terminated, truncated, outcome = 0.0, False, False, {}
        pixels = None
        for count in range(frames):
            if terminated or truncated:
                self._part(frame, f'the recording goes on where the simulator ends (after '
                                  f'{count} of {frames} frames)')
                self._driving = None
                self._not_driven.add(frame.step.episode)
                self.result.differing_frames += 1
                return
            pixels, earned, terminated, truncated, outcome = self._env.step(
                action, draw=count == frames - 1)
            reward = earned if count == 0 else reward + earned
        self._return += reward
        left_field = terminated and not outcome.get('lap_finished', False)
        self._compare(frame, pixels, reward, terminated, truncated, left_field)
        if (terminated or truncated) and not frame.step.ended:
            # whatever follows has nothing to be compared with
            self._driving = None
            self._not_driven.add(frame.step.episode)

    def _compare(
        self, frame: RecordedFrame, pixels: np.ndarray | None, reward: float, terminated: bool,
        truncated: bool, left_field: bool,
    ) -> None:
        result, step, known = self.result, frame.step, self._env.facts()
        result.frames += 1
        differences = []
        if frame.pixels is None:
            result.missing_images += 1
        elif pixels is None or not np.array_equal(frame.pixels, pixels):
            result.differing_images += 1
            differences.append('image')
        if step.reward != reward:
            result.differing_rewards += 1
            differences.append(f'reward {step.reward!r} instead of {reward!r}')
        flags = {
            'left_field': left_field,
            'lap_finished': known.lap_finished and not left_field,
            'ended_early': known.ended_early, 'came_round': known.came_round}
        wrong = [name for name, value in flags.items()
                 if name in step.info and step.info[name] != value]
        wrong += ['terminated'] * (step.terminated != terminated)
        wrong += ['truncated'] * (step.truncated != truncated)
        wrong += ['episode_return'] * (step.episode_return != self._return)
        result.differing_flags += bool(wrong)
        differences += wrong
        expected = {
            'step': known.frames,
            'tiles_visited': known.tiles_visited, 'tiles_total': known.tiles_total,
            'tiles_missed': known.tiles_missed, 'lap_position': known.lap_position,
            'wheels_off_road': known.wheels_off_road, 'speed': known.speed,
            'standing_still': known.standing_still}
        wrong = [name for name, value in expected.items()
                 if name in step.info and step.info[name] != value]
        result.differing_facts += bool(wrong)
        differences += wrong
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


def _constants(reader: BagReader, namespace: str) -> dict[int, dict[str, float]]:
    """Return episode -> what its `episode` messages say is constant for the run, and more."""
    name = find_topic(reader, EPISODE, namespace=namespace)
    if name is None:
        return {}
    decoder = BundleDecoder()
    constants = {}
    for message in reader.messages([name]):
        values = decoder.decode(message.data, name).values_with(('episode',))
        constants[int(values['episode'])] = values
    return constants


def _frame_limit(reader: BagReader, namespace: str) -> int:
    """Return after how many frames episodes were cut off, as most of those cut off show it."""
    name = find_topic(reader, STEP, namespace=namespace)
    decoder = StepDecoder()
    limits: Counter[int] = Counter()
    for message in reader.messages([name]) if name else ():
        _, step = decoder.decode(message.data, name)
        if step.truncated and not step.info.get('ended_early', 0):
            limits[int(step.info.get('step', step.decision))] += 1
    return limits.most_common(1)[0][0] if limits else DEFAULT_MAX_FRAMES


def _simulator_settings(reader: BagReader) -> dict[str, Any]:
    """Return the simulator's settings from the provenance, empty if it has none."""
    try:
        settings = json.loads(reader.custom_data.get('simulator', '{}'))
    except ValueError:
        return {}
    return settings if isinstance(settings, dict) else {}
