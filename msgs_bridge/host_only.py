# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Keeps the graph on this host unless its user opens it; docs/security.md says what that means.

`ROS_AUTOMATIC_DISCOVERY_RANGE` is the one switch: SUBNET opens, anything else keeps closed. The
range alone closes nothing: LOCALHOST says whom this process looks for, while its sockets hear
every address, so that whoever names this host in `ROS_STATIC_PEERS` gets in. So what is closed
runs in SYSTEM_DEFAULT, which leaves everything to the profile of Fast DDS, and a profile of ours
keeps its sockets on the loopback address; another one is for a graph that is open.

`python -m msgs_bridge.host_only` prints the same for a shell to evaluate, for tools that are not
ours.
"""
from __future__ import annotations

from collections.abc import MutableMapping
import os
from pathlib import Path
import shlex
import socket
import sys
from xml.etree import ElementTree

from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from msgs_bridge.regular_file import read_regular
from msgs_bridge.share import share_path

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
OPEN = 'SUBNET'
# rmw_fastrtps adds nothing to the profile; OFF finds nobody at all
CLOSED, OFF = 'SYSTEM_DEFAULT', 'OFF'
# where no profile of ours holds
UNPROFILED = 'LOCALHOST'
CLOSED_PROFILE = Path('config/only_this_host.xml')
OPEN_PROFILE = Path('config/open_to_network.xml')

PROFILE_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
"""Where Fast DDS 2 is told of a profile."""

SKIP_VARIABLE = 'SKIP_DEFAULT_XML_FILE'
"""Keeps Fast DDS from a profile that happens to lie in the current folder."""

MAX_PROFILE_BYTES = 2**20


def stay_on_this_host() -> None:
    """
    Set the environment for DDS, before `rclpy.init`; child processes inherit it.

    Raises:
        BridgeError: the loopback interface is down, so that no node would find another.
    """
    _set(os.environ)
    if Path(os.environ.get(PROFILE_VARIABLE, '')).name == CLOSED_PROFILE.name:
        _check_loopback()


def check_profile() -> None:
    """
    See that Fast DDS can read the profile that it is told of.

    It goes on without one that it cannot read, with sockets that hear every address.

    Raises:
        BridgeError: it cannot, and the graph is to stay on this host.
    """
    profile = os.environ.get(PROFILE_VARIABLE)
    if not profile or os.environ.get(RANGE) == OPEN:
        return
    try:
        root = ElementTree.fromstring(read_regular(profile, MAX_PROFILE_BYTES, BridgeError))
        if root.tag.rpartition('}')[2] not in ('dds', 'profiles'):
            raise BridgeError(f'{profile}: no profiles in it')
    except (BridgeError, ElementTree.ParseError, ValueError, LookupError) as error:
        reason = str(error) if isinstance(error, BridgeError) else f'{profile}: no XML'
        raise BridgeError(
            f'{PROFILE_VARIABLE} names no profile of Fast DDS ({plain(reason, 200)}), and without '
            f'one other hosts get in: unset it, or set {RANGE}=SUBNET to let them') from None


def _set(environment: MutableMapping[str, str]) -> None:
    opened = environment.get(RANGE) == OPEN
    profile = environment.get(PROFILE_VARIABLE)
    # an empty name is none to ROS
    middleware = environment.get('RMW_IMPLEMENTATION') or 'rmw_fastrtps'
    fast_dds = middleware.startswith('rmw_fastrtps')
    # one of ours may be from before its user opened the range, or of an install that was moved
    ours = fast_dds and (
        not profile or Path(profile).name in (CLOSED_PROFILE.name, OPEN_PROFILE.name))
    if environment.get(RANGE) not in (OPEN, OFF):
        environment[RANGE] = CLOSED if ours else UNPROFILED
    if not ours:
        return
    environment[PROFILE_VARIABLE] = str(
        share_path(OPEN_PROFILE if opened else CLOSED_PROFILE).absolute())
    # the older switch, which would take the place of the range
    environment.pop('ROS_LOCALHOST_ONLY', None)
    if not opened:
        environment[SKIP_VARIABLE] = '1'
    elif profile:
        environment.pop(SKIP_VARIABLE, None)


def _check_loopback() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        try:
            one.bind(('127.0.0.1', 0))
            one.sendto(b'', one.getsockname())
        except OSError as error:
            raise BridgeError(
                f'the loopback interface does not carry messages ({error.strerror}), and nodes on '
                'one host find each other through it: `ip link set lo up` brings it up') from None


def _shell_lines() -> str:
    """Return what `stay_on_this_host` changes, as lines for a shell."""
    before = dict(os.environ)
    after = dict(before)
    _set(after)
    lines = [f'export {name}={shlex.quote(value)}' for name, value in after.items()
             if before.get(name) != value]
    lines += [f'unset {name}' for name in before if name not in after]
    return '\n'.join(lines)


if __name__ == '__main__':
    sys.stdout.write(_shell_lines() + '\n')
