# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Transitions out of bags, joined exactly as they are live."""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from bags.topic_lookup import find_topic, need_topic
from bags.decode import decode, decode_image
from bags.errors import BagError
from bags.reader import BagReader
from bags.steps import decode_step
from msgs_bridge.errors import MessageError
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import Step
from msgs_bridge.topics import CMD_VEL, IMAGE, PLAIN_TWIST_TYPE, STEP
from msgs_bridge.transitions import Transition, TransitionJoiner
from msgs_bridge.twists import Command, read_command

# a recorder that ends cuts its topics off at moments so many messages apart, no more
TORN_END = 8


def bag_transitions(
    paths: Iterable[Path | str],
    *,
    namespace: str = '',
    counts: Counter[str] | None = None,
) -> Iterator[Transition]:
    """
    Yield the transitions of bags, one bag after another, as `TransitionJoiner` joins them.

    Whoever drove: the twist that was applied is the command. Without a stamped `cmd_vel` in the
    bag the command is what `step` says was applied.

    Args:
        paths: bag folders or files.
        namespace: where the topics of the car are; needed if there are several.
        counts: follows the joiner's counts, and `rejected` for unusable messages.

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
    if twists is not None and (reader.topics[twists].type_name == PLAIN_TWIST_TYPE
                               or reader.topics[twists].message_count == 0):
        # without stamps nothing says which frame a twist answered
        twists = None
    joiner = TransitionJoiner()
    joiner.counts = counts
    wanted = [images, steps] if twists is None else [images, steps, twists]
    for message in reader.messages(wanted):
        try:
            if message.topic == images:
                joined = joiner.add_image(*decode_image(
                    message.data, images, reader.topics[images].type_name))
            elif message.topic == steps:
                stamp, step = decode_step(message.data, steps)
                joined = [] if twists is not None else _applied(joiner, step)
                joined += joiner.add_step(stamp, step)
            else:
                twist = decode(message.data, CMD_VEL.type_name, CMD_VEL.name)
                joined = joiner.add_twist(
                    to_nanoseconds(twist.header.stamp), read_command(twist.twist))
        except (BagError, MessageError):
            # live nodes pass over such a message too
            counts['rejected'] += 1
            continue
        yield from joined
    if joiner.waiting > TORN_END:
        # a topic that ended before the others
        yield from joiner.end()


def _applied(joiner: TransitionJoiner, step: Step) -> list[Transition]:
    """Take the command that `step` says was applied in place of the twist."""
    if step.applied is None:
        return []
    try:
        command = Command(*(step.info[name] for name in Command._fields))
    except KeyError as error:
        raise MessageError(f'step lacks {error.args[0]!r}, and no twist says it') from None
    return joiner.add_twist(step.applied, command)
