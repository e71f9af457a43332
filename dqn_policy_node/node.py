# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
dqn_policy_node: images in, twists out.

Purpose: answer every image with the action of the greedy (or epsilon-greedy) policy.

Subscribes: `image_raw`, `weights`. Publishes: `cmd_vel`, `q_values`, `/diagnostics`.
Parameters: `dqn_policy_node/settings.py`.

Behaviour when things go wrong: an image that cannot be used and weights whose hash, description
or values are wrong are counted and logged (throttled), and the node goes on as it was; when no
image comes for `stale_after`, one zero twist is sent.
"""
from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.action_space import DUMMY_SPACE
from dqn_policy_node.device import choose_device
from dqn_policy_node.pilot import Pilot
from dqn_policy_node.policy import load_policy, Policy, RandomPolicy
from dqn_policy_node.settings import PolicySettings
from dqn_policy_node.shipped_models import find_model
from dqn_policy_node.weights_message import decode_weights
from geometry_msgs.msg import Twist, TwistStamped
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.images import image_to_array
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import NodeShell, run_node
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds
from msgs_bridge.twists import Command, fill_twist, STOP
from sensor_msgs.msg import JointState
import torch

NO_MODEL = ''
RANDOM_MODEL = 'random'
# of weights only the last is of use, but a reader that keeps few goes deaf in a flood
WEIGHTS_DEPTH = 100


class DqnPolicyNode(NodeShell):
    """The policy as a node; `Pilot` decides when, the policy decides what."""

    def __init__(self) -> None:
        """Declare parameters and load the model, or wait for weights."""
        super().__init__('dqn_policy_node', PolicySettings)
        settings = self.settings
        self._pilot: Pilot | None = None
        self._device = choose_device(settings.device)
        # one observation at a time gains nothing from a second thread, and takes a core
        torch.set_num_threads(1)
        if settings.model == RANDOM_MODEL:
            self._take_policy(RandomPolicy(DUMMY_SPACE))
        elif settings.model != NO_MODEL:
            self._take_policy(load_policy(find_model(settings.model), device=self._device))
        stamped = settings.cmd_vel_stamped
        self._cmd_vel = self.publisher(
            topics.CMD_VEL, type_name=None if stamped else 'geometry_msgs/msg/Twist')
        self._q_values = self.publisher(topics.Q_VALUES)
        # only the newest matters: an old image has no use any more, nor have old weights
        self.subscription(topics.IMAGE, self._on_image, eager=True, newest=True)
        if settings.hot_swap:
            self.subscription(
                topics.WEIGHTS, self._on_weights, depth=WEIGHTS_DEPTH, newest=True)
        self._last_image = time.monotonic()
        self._halted = True
        self._connected = False
        if settings.stale_after:
            self.create_timer(settings.stale_after / 2, self._watch_images)
        self.get_logger().info(
            f'driving with {settings.model}' if self._pilot else 'waiting for weights')

    def _take_policy(self, policy: Policy | RandomPolicy) -> None:
        policy.reset(self.settings.seed)
        policy.epsilon = self.settings.epsilon
        self._pilot = Pilot(policy, int(self.settings.scene_gap * NANOSECONDS))

    def _on_image(self, message: object) -> None:
        if self._pilot is None:
            self.counts['images_without_weights'] += 1
            return
        if not self._connected:
            wanted = self.settings.wait_for_subscribers
            self._connected = self._cmd_vel.get_subscription_count() >= wanted
            if not self._connected:
                # a simulator in lockstep sends the frame again
                self.counts['images_before_connected'] += 1
                return
        frame = image_to_array(message)
        try:
            answer = self._pilot.answer(to_nanoseconds(message.header.stamp), frame)
        except BridgeError as error:
            raise MessageError(str(error)) from None
        self._last_image, self._halted = time.monotonic(), False
        self.counts['images'] += 1
        self._send(answer.command, message.header.stamp)
        decision = answer.decision
        if decision is None:
            return
        self.counts['decisions'] += 1
        policy = self._pilot.policy
        values = {}
        if decision.q_values is not None:
            values.update(zip(policy.action_names, decision.q_values))
        values['chosen'] = decision.index
        values['explored'] = decision.explored
        values['weights_version'] = policy.version
        self._q_values.publish(fill_named_values(
            JointState(), values, to_nanoseconds(message.header.stamp)))

    def _send(self, command: Command, stamp: object | None) -> None:
        if not self.settings.cmd_vel_stamped:
            self._cmd_vel.publish(fill_twist(Twist(), command))
            return
        message = TwistStamped()
        if stamp is not None:
            message.header.stamp = stamp
        fill_twist(message.twist, command)
        self._cmd_vel.publish(message)

    def _watch_images(self) -> None:
        """Send one zero twist, stamped zero, when the images have stopped."""
        if not self._halted and time.monotonic() - self._last_image > self.settings.stale_after:
            self._halted = True
            self.counts['stale_images'] += 1
            self.get_logger().warn(f'no image for {self.settings.stale_after:g} s: zero twist')
            self._send(STOP, None)

    def _on_weights(self, message: object) -> None:
        """Swap in new weights between two decisions."""
        if isinstance(self._pilot, Pilot) and isinstance(self._pilot.policy, RandomPolicy):
            return
        try:
            description = self._pilot.policy.description if self._pilot else None
            update = decode_weights(bytes(message.data), description)
            if self._pilot is None:
                self._take_policy(Policy(update.description, device=self._device))
            self._pilot.policy.swap_weights(update)
        except BridgeError as error:
            raise MessageError(str(error)) from None
        if not self.settings.explore:
            self._pilot.policy.epsilon = self.settings.epsilon
        self.counts['weight_swaps'] += 1

    def settings_changed(self) -> None:
        """Take over a new epsilon."""
        if self._pilot is not None and not self.settings.explore:
            self._pilot.policy.epsilon = self.settings.epsilon

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what drives and how often it has answered."""
        if self._pilot is None:
            return DiagnosticStatus.WARN, 'waiting for weights', {}
        policy = self._pilot.policy
        return DiagnosticStatus.OK, 'driving', {
            'weights_version': policy.version, 'epsilon': float(policy.epsilon),
            'scenes': self._pilot.scenes}


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(DqnPolicyNode, args)


if __name__ == '__main__':
    sys.exit(main())
