# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
What drives a simulator, whichever it is: found by name, episodes on one clock, and the node.

Only `node` imports rclpy; simulators themselves are imported when they are asked for.
"""
from carracing_dqn.simulation.drive import Drive, Frame, open_drive
from carracing_dqn.simulation.registry import find_simulator, make_simulator, simulator_names

__all__ = [
    'Drive', 'Frame', 'find_simulator', 'make_simulator', 'open_drive', 'simulator_names',
]
