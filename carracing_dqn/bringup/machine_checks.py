# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What of this machine nodes need, each with what mends it; nothing here imports rclpy."""
from __future__ import annotations

from collections.abc import Iterator
import importlib.metadata
import importlib.util
import os
from pathlib import Path
import platform
import resource
import shutil
import socket
import sys

from carracing_dqn.simulation.fit import BAD, Finding, GOOD, UNSURE
from msgs_bridge.before_rclpy import is_domain
from msgs_bridge.errors import BridgeError
from msgs_bridge.host_only import (
    OPEN, PROFILE_VARIABLE, RANGE, stay_on_this_host, UNPROFILED,
)
from msgs_bridge.log_folder import ensure_log_folder, VARIABLE as LOG_VARIABLE
from msgs_bridge.machine import code_version, cores

PYTHONS = ((3, 10), (3, 14))
LIBRARIES = ('rclpy', 'ros-rclpy', 'gymnasium', 'torch', 'numpy', 'mcap', 'rosbags', 'textual')
# ports of DDS above these domains are those that Linux hands out to others
MOST_DOMAIN = 101
# what a graph opens at least, and what it should have
FEW_FILES, ENOUGH_FILES = 64, 1024
# a bag of an hour takes 5 GB
LEAST_DISK = 1 << 30
# a message of a large camera is torn in pieces that have to wait here
ENOUGH_RECEIVE = 1 << 20
GIB = 1 << 30


def machine_findings() -> Iterator[Finding]:
    """Yield what was found of everything that can be looked at without a graph."""
    yield _python()
    yield _libraries()
    yield _ros()
    yield _domain()
    yield _range()
    yield _sockets()
    yield _files()
    yield _home()
    yield _disk()
    yield _gpu()


def _python() -> Finding:
    low, high = PYTHONS
    found = f'{platform.python_version()}, {cores()} cores, carracing_dqn {code_version()}'
    if not low <= sys.version_info[:2] < high:
        return Finding('python', BAD, found, 'Python 3.10 to 3.13')
    return Finding('python', GOOD, found)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ''


def _libraries() -> Finding:
    found = ', '.join(f'{name} {version}' for name in LIBRARIES if (version := _version(name)))
    missing = [name for name in ('torch', 'gymnasium', 'mcap', 'rosbags', 'numba', 'Box2D')
               if importlib.util.find_spec(name) is None]
    if missing:
        return Finding('libraries', BAD, f'{", ".join(missing)} missing; {found}', 'make setup')
    return Finding('libraries', GOOD, found)


def _ros() -> Finding:
    spec = importlib.util.find_spec('rclpy')
    if spec is None:
        return Finding('ROS', BAD, 'no rclpy', "source /opt/ros/jazzy/setup.bash, or pip install "
                       "'.[wheels]'")
    installed = not str(spec.origin).startswith(sys.prefix)
    found = 'an installed ROS' if installed else 'the wheels'
    distro = os.environ.get('ROS_DISTRO', '')
    middleware = os.environ.get('RMW_IMPLEMENTATION') or 'the default middleware'
    if installed and distro != 'jazzy':
        return Finding('ROS', UNSURE, f'{found}, {distro or "unknown distro"}, {middleware}',
                       'Jazzy is what was tested')
    return Finding('ROS', GOOD, f'{found}, {middleware}')


def _domain() -> Finding:
    text = os.environ.get('ROS_DOMAIN_ID', '') or '0'
    if not is_domain(text):
        return Finding('domain', BAD, f'ROS_DOMAIN_ID is {text[:20]!r}',
                       f'a number from 0 to {MOST_DOMAIN}')
    if int(text) > MOST_DOMAIN:
        return Finding('domain', UNSURE, text, f'up to {MOST_DOMAIN}: the ports of higher ones '
                       'are handed out by Linux to others')
    return Finding('domain', GOOD, text + ('' if int(text) else ', which everybody has who sets '
                                           'none'))


def _range() -> Finding:
    try:
        stay_on_this_host()
    except BridgeError as error:
        return Finding('discovery', BAD, str(error), 'ip link set lo up')
    chosen = os.environ[RANGE]
    profile = os.environ.get(PROFILE_VARIABLE, '')
    peers = os.environ.get('ROS_STATIC_PEERS', '')
    found = (f'{RANGE} is {chosen}' + (f', {Path(profile).name}' if profile else '')
             + (f', peers {peers[:60]}' if peers else ''))
    if chosen == OPEN:
        return Finding('discovery', UNSURE, f'{found}: other hosts get in',
                       f'unset {RANGE} keeps the graph on this host; docs/security.md')
    if profile and not Path(profile).is_file():
        return Finding('discovery', BAD, f'{found}: there is no such file',
                       f'unset {PROFILE_VARIABLE}')
    if chosen == UNPROFILED:
        return Finding('discovery', UNSURE, f"{found}: who knows this host's address may get in",
                       f'unset {PROFILE_VARIABLE} and RMW_IMPLEMENTATION, or a firewall; '
                       'docs/security.md')
    return Finding('discovery', GOOD, f'{found}: this host only')


def _sockets() -> Finding:
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.bind(('127.0.0.1', 0))
            one.settimeout(1.0)
            one.sendto(b'x', one.getsockname())
            one.recv(1)
    except OSError as error:
        return Finding('sockets', BAD, f'UDP on 127.0.0.1: {error}',
                       'a firewall or a sandbox keeps them closed')
    try:
        most = int(Path('/proc/sys/net/core/rmem_max').read_text())
    except (OSError, ValueError):
        return Finding('sockets', GOOD, 'UDP on 127.0.0.1 works')
    if most < ENOUGH_RECEIVE:
        return Finding('sockets', UNSURE, f'UDP works; at most {most >> 10} KiB wait (rmem_max)',
                       f'sysctl -w net.core.rmem_max={ENOUGH_RECEIVE << 2} for large cameras')
    return Finding('sockets', GOOD, f'UDP on 127.0.0.1 works, up to {most >> 10} KiB wait')


def _files() -> Finding:
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= ENOUGH_FILES:
        return Finding('open files', GOOD, f'{soft} (ulimit -n)')
    return Finding('open files', BAD if soft < FEW_FILES else UNSURE, f'{soft} (ulimit -n)',
                   f'ulimit -n {ENOUGH_FILES}')


def _home() -> Finding:
    try:
        ensure_log_folder()
    except BridgeError as error:
        return Finding('home', BAD, str(error), f'export {LOG_VARIABLE}=/tmp/ros_log')
    home = os.environ.get('HOME')
    if not home:
        return Finding('home', UNSURE, 'HOME is not set; logs go to '
                       f'{os.environ.get(LOG_VARIABLE, "a temporary folder")}', 'export HOME')
    return Finding('home', GOOD, 'ROS can write its logs')


def _room(name: str, place: str, least: int, mend: str) -> Finding:
    try:
        free = shutil.disk_usage(place).free
    except OSError as error:
        return Finding(name, BAD, f'{place}: {error.strerror}', mend)
    found = f'{free / GIB:.1f} GiB free in {place}'
    if not os.access(place, os.W_OK):
        return Finding(name, BAD, f'{place} cannot be written', mend)
    return Finding(name, GOOD if free >= least else BAD, found, '' if free >= least else mend)


def _disk() -> Finding:
    return _room('disk', '.', LEAST_DISK, 'room in the current folder, where bags and runs go')


def _gpu() -> Finding:
    if importlib.util.find_spec('torch') is None:
        return Finding('GPU', UNSURE, 'no PyTorch', 'make setup')
    # it takes seconds to load
    import torch
    if torch.cuda.is_available():
        return Finding('GPU', GOOD, torch.cuda.get_device_name(0))
    built = torch.version.cuda or torch.version.hip
    if built and any(Path(place).exists() for place in ('/dev/nvidiactl', '/dev/kfd')):
        return Finding('GPU', UNSURE, 'there is one that PyTorch cannot use',
                       'make setup TORCH=auto takes the build for it')
    return Finding('GPU', GOOD, 'none: everything runs on the processor')
