# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag are those of the contract, in whatever namespace they were."""
from __future__ import annotations

from bags.errors import BagError
from bags.reader import BagReader
from msgs_bridge.topics import CMD_VEL, COMPRESSED_TYPE, IMAGE, PLAIN_TWIST_TYPE, Topic

# cmd_vel may be published without a stamp


# what may stand in place of the contract's types
OTHER_TYPES = {CMD_VEL: (PLAIN_TWIST_TYPE,), IMAGE: (COMPRESSED_TYPE,)}


def find_topic(reader: BagReader, topic: Topic, *, namespace: str = '') -> str | None:
    """
    Return the full name of a topic of the contract in a bag, or None.

    Args:
        reader: the bag.
        topic: the topic of the contract.
        namespace: where to look; empty = anywhere.

    Raises:
        BagError: several namespaces have it and none was chosen.
    """
    types = {topic.type_name, *OTHER_TYPES.get(topic, ())}
    tail = '/' + topic.name.lstrip('/')
    place = '/' + namespace.strip('/') if namespace.strip('/') else None
    found = [
        name for name, entry in reader.topics.items()
        if entry.type_name in types and name.endswith(tail)
        and (place is None or name == place + tail)]
    if len(found) > 1:
        raise BagError(f'{reader.path} has {topic.name} more than once: {", ".join(found)}; '
                       'choose with --namespace')
    return found[0] if found else None


def need_topic(reader: BagReader, topic: Topic, *, namespace: str = '') -> str:
    """
    Return the full name of a topic of the contract in a bag.

    Raises:
        BagError: it is not there, or there more than once.
    """
    name = find_topic(reader, topic, namespace=namespace)
    if name is None:
        raise BagError(f'{reader.path} has no {topic.name} of type {topic.type_name}; '
                       f'it has {", ".join(sorted(reader.topics)) or "no topics"}')
    return name
