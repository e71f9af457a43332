# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m dqn_policy_node` runs the node."""
import contextlib
import sys

# its imports take seconds, in which it may be stopped
with contextlib.suppress(KeyboardInterrupt):
    from dqn_policy_node.node import main

    sys.exit(main())
