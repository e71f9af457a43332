# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
carracing_sim_node: CarRacing-v3, or another simulator by name, behind twists.

What it subscribes, publishes and does when things go wrong: `carracing_dqn/simulation/node.py`.
Parameters: those described there and, with the default `simulator`, in
`carracing_sim_node/settings.py`.
"""
from __future__ import annotations

import functools
import sys

from carracing_dqn.simulation.node import SimulatorNode
from msgs_bridge.node_shell import run_node


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(functools.partial(SimulatorNode, 'carracing_sim_node'), args)


if __name__ == '__main__':
    sys.exit(main())
