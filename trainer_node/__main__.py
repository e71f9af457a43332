# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m trainer_node` runs the node."""
import sys

from msgs_bridge.early_interrupt import ends_when_interrupted

with ends_when_interrupted():
    from trainer_node.node import main

sys.exit(main())
