# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a recorder says of itself while it records: what it waits for, and what it has."""
from __future__ import annotations

from collections.abc import Collection

from bags.live_line import clock_text
from msgs_bridge.plain_text import plain
from msgs_bridge.topics import DIAGNOSTICS

# every node publishes these, the recorder too, so they tell nothing of a graph
EVERYWHERE = {DIAGNOSTICS.name, '/rosout', '/parameter_events'}
# names in a line
MOST_NAMES = 5


def waits_for(
    wanted: Collection[str] | None, came: Collection[str], published: Collection[str],
    domain: str,
) -> str:
    """
    Return what nothing has come of and why, '' if nothing is waited for.

    Args:
        wanted: names of the topics that were asked for; None = all.
        came: those of which a message has come.
        published: those that somebody publishes.
        domain: ROS_DOMAIN_ID.
    """
    if wanted is None:
        if set(came) - EVERYWHERE:
            return ''
        others = sorted(set(published) - EVERYWHERE)
        if others:
            return f'waits for the first message of {_names(others)}'
        return f'waits for a graph: nobody publishes anything on domain {domain}'
    missing = sorted(set(wanted) - set(came))
    unpublished = [name for name in missing if name not in published]
    if unpublished:
        return f'waits for {_names(unpublished)}: nobody publishes that on domain {domain}'
    return f'waits for the first message of {_names(missing)}' if missing else ''


def recorded_text(seconds: float, messages: int, topics: int, size: int, lost: int) -> str:
    """Return how much was recorded in some seconds; `size` in bytes."""
    return (f'{clock_text(seconds)}, {messages} messages of {topics} topics, '
            f'{size / 1e6:.1f} MB, {lost or "none"} lost')


def _names(names: list[str]) -> str:
    shown = ', '.join(map(plain, names[:MOST_NAMES]))
    return f'{shown} and {len(names) - MOST_NAMES} more' if len(names) > MOST_NAMES else shown
