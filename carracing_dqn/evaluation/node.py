# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
validation_node: greedy laps with the weights that the trainer publishes.

Purpose: drive greedy laps on the validation tracks, in this process, with every version of the
weights that the trainer marks for validation.

Subscribes: `weights`. Publishes: `validation`, `/diagnostics`.
Parameters: `carracing_dqn/evaluation/settings.py`.

Behaviour when things go wrong: weights whose hash, description or values are wrong are counted
and logged (throttled); while laps are driven, newer versions wait and only the newest is driven.
"""
from __future__ import annotations

import sys

from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.policy import Policy
from dqn_policy_node.weights_message import decode_weights, is_marked, WeightsUpdate
from carracing_dqn.evaluation.settings import ValidationSettings
from carracing_dqn.evaluation.validator import validate
from carracing_dqn.simulation import make_simulator
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import NodeShell, run_node
from msgs_bridge.stamps import to_nanoseconds
from sensor_msgs.msg import JointState

# Marked versions that may wait behind the laps of another.
WAITING = 20


class ValidationNode(NodeShell):
    """The validator as a node."""

    def __init__(self) -> None:
        """Declare parameters and wait for marked weights."""
        super().__init__('validation_node', ValidationSettings)
        self._simulator = make_simulator(self.settings.simulator)
        self._wanted: WeightsUpdate | None = None
        self._driven = -1
        self._validation = self.publisher(topics.VALIDATION)
        self.subscription(topics.WEIGHTS, self._on_weights, depth=WAITING)
        self.create_timer(0.1, self._drive)

    def _on_weights(self, message: object) -> None:
        try:
            data = bytes(message.data)
            update = decode_weights(data) if is_marked(data) else None
        except BridgeError as error:
            raise MessageError(str(error)) from None
        if update is not None and update.version != self._driven:
            self._wanted = update

    def _drive(self) -> None:
        """Drive the laps of the newest marked version."""
        update, self._wanted = self._wanted, None
        if update is None:
            return
        self._driven = update.version
        policy = Policy(update.description, frame_seconds=self._simulator.frame_seconds)
        policy.swap_weights(update)
        policy.epsilon = 0.0
        seeds = range(self.settings.seed, self.settings.seed + self.settings.tracks)
        result = validate(policy, seeds, version=update.version, simulator=self._simulator,
                          should_stop=lambda: not self.context.ok())
        if not self.context.ok():
            return
        now = to_nanoseconds(self.get_clock().now().to_msg())
        self._validation.publish(fill_named_values(JointState(), result, now))
        self.counts['validations'] += 1
        self.get_logger().info(
            f'version {update.version}: mean {result["mean"]:.1f}, '
            f'{result["completed"]:.0%} completed, {result["seconds"]:.1f} s')

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return the version that was driven last."""
        return DiagnosticStatus.OK, 'validating', {'version': self._driven}


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(ValidationNode, args)


if __name__ == '__main__':
    sys.exit(main())
