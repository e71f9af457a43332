# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
QoS of a recorded topic as the plain lists and dicts that rosbag2 writes as YAML.

Since metadata version 9 the policies are names; versions 4 to 8 had the numbers of rmw. Both are
read, names are written.
"""
from __future__ import annotations

from typing import Any

from bags.errors import BagError
from bags.yaml_text import dump_yaml, load_yaml

INFINITE = {'sec': 9223372036, 'nsec': 854775807}
# rmw/types.h; the order is that of the enumerations there
NAMES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': (
        'system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': (
        'system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': (
        'system_default', 'automatic', 'manual_by_node', 'manual_by_topic', 'unknown',
        'best_available'),
}
DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')
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
        'avoid_ros_namespace_conventions': False,
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
    return normalize_qos(load_yaml(text, 'QoS profiles')) if text else []


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
    return [_normalize(profile) for profile in profiles]


def _normalize(profile: dict[str, Any]) -> dict[str, Any]:
    result = offered_qos()
    for policy, names in NAMES.items():
        value = profile.get(policy, 'unknown')
        if isinstance(value, int):
            value = names[value] if 0 <= value < len(names) else 'unknown'
        result[policy] = value if value in names else 'unknown'
    try:
        result['depth'] = int(profile.get('depth', 0))
        for name in DURATIONS:
            given = profile.get(name) or INFINITE
            result[name] = {'sec': int(given['sec']), 'nsec': int(given['nsec'])}
    except (TypeError, ValueError, LookupError, OverflowError):
        raise BagError('QoS profile with a depth or a duration that is no number') from None
    result['avoid_ros_namespace_conventions'] = bool(
        profile.get('avoid_ros_namespace_conventions', False))
    return result
