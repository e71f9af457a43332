# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What makes messages travel faster than rclpy alone: each trick with a switch and a fallback."""
