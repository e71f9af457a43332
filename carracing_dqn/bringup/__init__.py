# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The `carracing` command and the runner that starts the nodes as processes."""
