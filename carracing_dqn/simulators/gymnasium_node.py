# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
gymnasium_sim_node: any environment of Gymnasium behind twists.

What it subscribes, publishes and does when things go wrong: `carracing_dqn/simulation/node.py`.
Parameters: those described there and in `carracing_dqn/simulators/gymnasium_env.py`.
"""
from __future__ import annotations

import functools
import sys

from carracing_dqn.simulation.node import SimulatorNode
from msgs_bridge.node_shell import run_node


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(
        functools.partial(SimulatorNode, 'gymnasium_sim_node', 'gymnasium_env'), args)


if __name__ == '__main__':
    sys.exit(main())
