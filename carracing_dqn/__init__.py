# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What goes around the nodes: simulators by name, evaluation, the `carracing` command."""
