# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Transitions out of bags, joined exactly as they are live."""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from bags.contract import find_topic, need_topic, TWIST
from bags.decode import BundleDecoder, decode, ImageDecoder
from bags.reader import BagReader
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds
from msgs_bridge.topics import CMD_VEL, IMAGE, STEP
from msgs_bridge.transitions import Transition, TransitionJoiner
from msgs_bridge.twists import Action, twist_to_action

NEEDED = ('reward', 'terminated', 'truncated', 'episode', 'decision', 'applied_sec',
          'applied_nanosec')
CONTROLS = ('steer', 'gas', 'brake')


def bag_transitions(
    paths: Iterable[Path | str],
    *,
    namespace: str = '',
    counts: Counter[str] | None = None,
) -> Iterator[Transition]:
    """
    Yield the transitions of bags, one bag after another, as `TransitionJoiner` joins them.

    Whoever drove: the twist that was applied is the action. Without a stamped `cmd_vel` in the
    bag the action is what `step` says was applied.

    Args:
        paths: bag folders or files.
        namespace: where the topics of the car are; needed if there are several.
        counts: is filled with the joiner's counts, and `rejected` for unusable messages.

    Raises:
        BagError: a bag that cannot be read, or lacks images or steps.
    """
    counts = Counter() if counts is None else counts
    for path in paths:
        with BagReader(path) as reader:
            yield from _transitions(reader, namespace, counts)


def _transitions(
    reader: BagReader, namespace: str, counts: Counter[str],
) -> Iterator[Transition]:
    images = need_topic(reader, IMAGE, namespace=namespace)
    steps = need_topic(reader, STEP, namespace=namespace)
    twists = find_topic(reader, CMD_VEL, namespace=namespace)
    if twists is not None and (reader.topics[twists].type_name == TWIST
                               or reader.topics[twists].message_count == 0):
        # without stamps nothing says which frame a twist answered
        twists = None
    joiner = TransitionJoiner()
    decoder = BundleDecoder()
    image_decoder = ImageDecoder()
    wanted = [images, steps] if twists is None else [images, steps, twists]
    needed = NEEDED + CONTROLS if twists is None else NEEDED
    try:
        for message in reader.messages(wanted):
            try:
                if message.topic == images:
                    joined = joiner.add_image(*image_decoder.decode(message.data, images))
                elif message.topic == steps:
                    bundle = decoder.decode(message.data, steps)
                    facts = bundle.values_with(needed)
                    joined = [] if twists is not None else _applied(joiner, facts)
                    joined += joiner.add_step(bundle.stamp, facts)
                else:
                    twist = decode(message.data, CMD_VEL.type_name, CMD_VEL.name)
                    action, _ = twist_to_action(twist.twist)
                    joined = joiner.add_twist(to_nanoseconds(twist.header.stamp), action)
            except MessageError:
                # live nodes pass over such a message too
                counts['rejected'] += 1
                continue
            yield from joined
    finally:
        counts.update(joiner.counts)


def _applied(joiner: TransitionJoiner, facts: dict[str, float]) -> list[Transition]:
    """Take the action that `step` says was applied in place of the twist."""
    if facts['applied_sec'] < 0:
        return []
    stamp = int(facts['applied_sec']) * NANOSECONDS + int(facts['applied_nanosec'])
    return joiner.add_twist(stamp, Action(*(facts[name] for name in CONTROLS)))
