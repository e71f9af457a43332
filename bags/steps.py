# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`step` bundles out of bags, those of version 0.1 among them, and what of a topic is usable."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from bags.decode import decode_bundle
from bags.errors import BagError
from bags.messages import BagMessage
from carracing_sim_node.controls import command_of
from msgs_bridge.errors import MessageError
from msgs_bridge.step import read_step, Step

PEDALS = ('steer', 'gas', 'brake')

T = TypeVar('T')


def decode_step(data: Any, what: str) -> tuple[int, Step]:
    """
    Return stamp in ns and step; `what` names the message in errors.

    Bags of version 0.1 say which controls were applied where later ones have the command.

    Raises:
        BagError: the bytes are not a JointState.
        MessageError: not a step that can be used.
    """
    bundle = decode_bundle(data, what)
    step = read_step(bundle.values_with())
    if 'linear' not in step.info and all(name in step.info for name in PEDALS):
        step.info.update(command_of(*(step.info[name] for name in PEDALS))._asdict())
    return bundle.stamp, step


def usable(
    messages: Iterable[BagMessage], decode: Callable[[Any], T], counts: Counter[str] | None = None,
) -> Iterator[tuple[BagMessage, T]]:
    """
    Yield messages with what they hold; those that cannot be used are passed over, as live.

    Args:
        messages: of one topic.
        decode: makes of bytes what they hold.
        counts: follows how many were `rejected`.

    Raises:
        BagError: a damaged bag.
    """
    for message in messages:
        try:
            held = decode(message.data)
        except (BagError, MessageError):
            if counts is not None:
                counts['rejected'] += 1
            continue
        yield message, held
