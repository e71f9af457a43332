# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
QoS of a recorded topic as the plain lists and dicts that rosbag2 writes as YAML.

Since metadata version 9 the policies are names; versions 4 to 8 had the numbers of rmw. Both are
read, names are written.
"""
from __future__ import annotations

from typing import Any

from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from bags.errors import BagError
from msgs_bridge.yaml_text import dump_yaml, load_yaml

INFINITE = {'sec': 9223372036, 'nsec': 854775807}
# a policy that a bag does not name
UNKNOWN = dict.fromkeys(('history', 'reliability', 'durability', 'liveliness'), 'unknown')
NAMESPACES = 'avoid_ros_namespace_conventions'
NANOSECONDS = 10 ** 9


def offered_qos(
    *, reliable: bool = True, latched: bool = False, depth: int = 0,
) -> dict[str, Any]:
    """Return the profile of one publisher; depth 0 is what discovery reports: unknown."""
    return {
        'history': 'keep_last' if depth else 'unknown',
        'depth': depth,
        'reliability': 'reliable' if reliable else 'best_effort',
        'durability': 'transient_local' if latched else 'volatile',
        'deadline': dict(INFINITE),
        'lifespan': dict(INFINITE),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(INFINITE),
        NAMESPACES: False,
    }


def duration_dict(nanoseconds: int) -> dict[str, int]:
    """Return a duration in ns as rosbag2 writes it."""
    if nanoseconds <= 0 or nanoseconds >= 2 ** 63 - 1:
        return dict(INFINITE)
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return {'sec': seconds, 'nsec': rest}


def qos_to_text(profiles: list[dict[str, Any]]) -> str:
    """Return the YAML that goes into the channel metadata `offered_qos_profiles`."""
    return dump_yaml(profiles) if profiles else ''


def qos_from_text(text: str) -> list[dict[str, Any]]:
    """
    Read the YAML of `offered_qos_profiles`, of any version.

    Raises:
        BagError: not YAML or not a list of profiles.
    """
    return normalize_qos(load_yaml(text, 'QoS profiles', BagError)) if text else []


def normalize_qos(profiles: Any) -> list[dict[str, Any]]:
    """
    Return profiles with policies as names and every key present.

    Raises:
        BagError: not a list of mappings with numbers where numbers belong.
    """
    if not profiles:
        return []
    if not isinstance(profiles, list) or not all(isinstance(one, dict) for one in profiles):
        raise BagError('QoS profiles are not a list of mappings')
    try:
        read = dump_qos_v9(parse_qos([{**offered_qos(), **UNKNOWN, **one} for one in profiles]))
    except (AttributeError, LookupError, TypeError, ValueError):
        # the library reads what is well-formed
        raise BagError('QoS profile with a policy or a duration that is none') from None
    numbers = [number for one in read for number in (
        one['depth'], *one['deadline'].values(), *one['lifespan'].values(),
        *one['liveliness_lease_duration'].values())]
    if not all(isinstance(number, int) for number in numbers):
        raise BagError('QoS profile with a depth or a duration that is no number')
    return [{**one, NAMESPACES: bool(one[NAMESPACES])} for one in read]
