# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The episodes that a bag holds, from its `step` bundles."""
from __future__ import annotations

from collections import Counter
import dataclasses
from typing import Any

from bags.decode import decode_bundle
from bags.reader import BagReader
from bags.steps import decode_step, usable
from bags.topic_lookup import find_topic
from carracing_dqn.simulation.checks import LONGEST_FRAME, SHORTEST_FRAME
from msgs_bridge.simulator import FRAME_SECONDS
from msgs_bridge.topics import EPISODE, STEP


@dataclasses.dataclass
class Episode:
    """
    One episode, or what the bag holds of it.

    Attributes:
        number: of the episode in its run.
        seed: of its track; -1 if it came from a stream or is none.
        start_time, end_time: log times of its first and last message, ns.
        decisions, frames: published frames after the reset frame, and simulator frames.
        episode_return: sum of rewards up to the last message.
        lap_finished, terminated, truncated: how it ended.
        whole: whether its first and its last frame are in the bag.
    """

    number: int
    seed: int
    start_time: int
    end_time: int = 0
    decisions: int = 0
    frames: int = 0
    episode_return: float = 0.0
    lap_finished: bool = False
    terminated: bool = False
    truncated: bool = False
    whole: bool = False


def episode_constants(
    reader: BagReader, *, namespace: str = '', counts: Counter[str] | None = None,
) -> dict[int, dict[str, float]]:
    """
    Return episode -> what its `episode` messages say is constant for the run, and more.

    Args:
        reader: the bag.
        namespace: where the topics of the car are; needed if there are several.
        counts: follows how many messages were `rejected`, as they cannot be used.

    Raises:
        BagError: a damaged bag.
    """
    name = find_topic(reader, EPISODE, namespace=namespace)

    def decode(data: Any) -> dict[str, float]:
        return decode_bundle(data, name).values_with(('episode',))

    messages = reader.messages([name]) if name else ()
    return {int(values['episode']): values for _, values in usable(messages, decode, counts)}


def frame_seconds(reader: BagReader, *, namespace: str = '') -> float:
    """
    Return the simulated seconds of a frame, CarRacing's where the bag does not say it.

    Raises:
        BagError: a damaged bag.
    """
    said = [values['frame_seconds'] for values in episode_constants(
        reader, namespace=namespace).values() if 'frame_seconds' in values]
    return said[0] if said and SHORTEST_FRAME <= said[0] <= LONGEST_FRAME else FRAME_SECONDS


def find_episodes(
    reader: BagReader, *, namespace: str = '', counts: Counter[str] | None = None,
) -> list[Episode]:
    """
    Return the episodes of a bag in order; none if it has no `step` topic.

    Args:
        reader: the bag.
        namespace: where the topics of the car are; needed if there are several.
        counts: follows how many messages were `rejected`, as they cannot be used.

    Raises:
        BagError: a damaged bag.
    """
    name = find_topic(reader, STEP, namespace=namespace)
    if name is None:
        return []
    episodes: list[Episode] = []
    present: Episode | None = None
    from_start = False
    for message, (_, step) in usable(
            reader.messages([name]), lambda data: decode_step(data, name), counts):
        if present is None or step.episode != present.number or (
                step.decision == 0 and present.decisions > 0):
            present = Episode(step.episode, step.seed, message.log_time)
            from_start = step.decision == 0
            episodes.append(present)
        present.end_time = message.log_time
        present.decisions = step.decision
        present.frames = int(step.info.get('step', step.decision))
        present.episode_return = step.episode_return
        present.lap_finished = step.info.get('lap_finished', 0) > 0
        present.terminated = step.terminated
        present.truncated = step.truncated
        present.whole = from_start and step.ended
    return episodes
