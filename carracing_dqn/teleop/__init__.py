# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A person drives: keys and joysticks as the commands of a policy."""
