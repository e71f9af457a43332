# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m carracing_dqn.bringup` is the `carracing` command."""
import sys

from carracing_dqn.bringup.start import carracing

sys.exit(carracing())
