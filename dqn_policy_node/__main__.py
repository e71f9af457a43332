# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m dqn_policy_node` runs the node."""
import sys

from msgs_bridge.early_interrupt import ends_when_interrupted

with ends_when_interrupted():
    from dqn_policy_node.node import main

sys.exit(main())
