# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Training runs that are compared, each in one process without ROS, and the page they make."""
