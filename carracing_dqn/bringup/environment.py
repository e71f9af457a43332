# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Lay out a Python environment so that ROS tools find the package in it.

`make setup` runs this module after an editable install. It makes what a colcon install would:
the ament index marker, `share/carracing_dqn`, executables in `lib/carracing_dqn`; and writes
`setup.bash`, to be sourced before using `ros2` with this environment.
"""
from __future__ import annotations

from importlib import metadata
import os
from pathlib import Path
import sys

from msgs_bridge.atomic_write import write_text

PACKAGE = 'carracing_dqn'
SHARED = ('package.xml', 'config', 'models', 'layouts')
SETUP_BASH = """\
# source this file: it puts carracing_dqn and its nodes where ROS tools look for them
prefix="$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")" && pwd)"
. "$prefix/bin/activate"
export AMENT_PREFIX_PATH="$prefix${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
export ROS_VERSION="${ROS_VERSION:-2}" ROS_PYTHON_VERSION="${ROS_PYTHON_VERSION:-3}"
export ROS_DISTRO="${ROS_DISTRO:-jazzy}"
# Nodes and tools that are started in this shell are not reached from other hosts: Fast DDS is kept
# on the loopback address, unless ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET, or
# FASTRTPS_DEFAULT_PROFILES_FILE names a profile of yours. After opening it source this file again.
eval "$("$prefix/bin/python" -m msgs_bridge.host_only)"
unset prefix
"""


def executables() -> list[str]:
    """Return what an install of the package puts on the path, as its metadata has it."""
    entry_points = metadata.distribution(PACKAGE).entry_points
    return sorted(point.name for point in entry_points if point.group == 'console_scripts')


def link(path: Path, target: Path) -> None:
    """Make `path` a relative link to `target`, in place of an older link."""
    if path.parent.is_symlink():
        path.parent.unlink()
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_symlink():
        path.unlink()
    path.symlink_to(os.path.relpath(target, path.parent))


def lay_out(prefix: Path, source: Path) -> None:
    """
    Make the ament layout of a checkout below a Python prefix.

    Args:
        prefix: the environment, with `bin` in it.
        source: the checkout.
    """
    link(prefix / 'share/ament_index/resource_index/packages' / PACKAGE,
         source / 'resource' / PACKAGE)
    for name in SHARED:
        link(prefix / 'share' / PACKAGE / name, source / name)
    # one by one: `ros2 launch` does not look into folders that are links
    for path in sorted((source / 'launch').glob('*.launch.py')):
        link(prefix / 'share' / PACKAGE / 'launch' / path.name, path)
    for name in executables():
        link(prefix / 'lib' / PACKAGE / name, prefix / 'bin' / name)
    write_text(prefix / 'setup.bash', SETUP_BASH)
    # by this name a colcon workspace on top of the environment looks for it
    link(prefix / 'local_setup.bash', prefix / 'setup.bash')


if __name__ == '__main__':
    lay_out(Path(sys.prefix), Path(__file__).resolve().parents[2])
