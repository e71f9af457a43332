# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
dqn_policy_node: images in, twists out.

Purpose: answer every image with the action of the greedy (or epsilon-greedy) policy. A camera
stage makes frames of the model's size out of any images, a command stage makes a robot's twists
out of the policy's commands.

Subscribes: `image_raw`, `weights`. Publishes: `cmd_vel`, `q_values`, `/diagnostics`.
Services: `~/enable` (std_srvs/SetBool): while disabled, one zero twist and then none.
Parameters: `dqn_policy_node/settings.py`.

Behaviour when things go wrong: an image that cannot be used and weights that are older than those
at work or whose hash, description or values are wrong are counted and logged (throttled), and the
node goes on as it was; when no image comes for `stale_after`, and at the end, one zero twist is
sent. Only the newest image that waits is answered, others are counted. The diagnostics say
"driving" only while images are answered and somebody hears the twists, else what is missing.
"""
from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.action_space import DUMMY_SPACE
from dqn_policy_node.camera import Camera
from dqn_policy_node.command_stage import CommandStage
from dqn_policy_node.device import choose_device
from dqn_policy_node.model_description import FRAME_SIDE
from dqn_policy_node.pilot import Pilot
from dqn_policy_node.policy import Answer, load_policy, Policy, RandomPolicy
from dqn_policy_node.settings import PolicySettings
from dqn_policy_node.shipped_models import RANDOM
from dqn_policy_node.weights_message import decode_weights, NewestWeights
from geometry_msgs.msg import Twist, TwistStamped
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import NodeShell, run_node
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds
from msgs_bridge.twists import Command, fill_twist
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
import torch

NO_MODEL = ''
# without an image for so long nothing drives; seconds
SILENCE_SECONDS = 2.0


class DqnPolicyNode(NodeShell):
    """The policy as a node; `Pilot` decides when, the policy decides what."""

    has_last_word = True

    def __init__(self) -> None:
        """Declare parameters and load the model, or wait for weights."""
        super().__init__('dqn_policy_node', PolicySettings)
        settings = self.settings
        self._pilot: Pilot | None = None
        self._device = choose_device(settings.device)
        # one observation at a time gains nothing from a second thread, and takes a core
        torch.set_num_threads(1)
        self._commands = CommandStage(settings)
        self._newest = NewestWeights()
        if settings.model == RANDOM:
            self._take_policy(RandomPolicy(DUMMY_SPACE))
        elif settings.model != NO_MODEL:
            self._take_policy(load_policy(settings.model, device=self._device))
        self._cmd_vel = self.publisher(
            topics.CMD_VEL,
            type_name=None if settings.cmd_vel_stamped else topics.PLAIN_TWIST_TYPE)
        self._q_values = self.publisher(topics.Q_VALUES)
        # only the newest matters: an old image has no use any more, nor have old weights
        self._images = self.subscription(
            topics.IMAGE, self._on_image, eager=True, newest=True,
            type_name=topics.COMPRESSED_TYPE if settings.camera_compressed else None)
        self._weights = self.subscription(
            topics.WEIGHTS, self._on_weights, newest=True,
        ) if settings.hot_swap else None
        self.create_service(SetBool, '~/enable', self._on_enable)
        self._enabled = True
        self._last_image: float | None = None
        self._halted = True
        self._stale = False
        self._connected = False
        if settings.stale_after:
            self.create_timer(settings.stale_after / 2, self._watch_images)
        self.get_logger().info(
            f'driving with {settings.model}' if self._pilot else 'waiting for weights')

    def _take_policy(self, policy: Policy | RandomPolicy) -> None:
        policy.reset(self.settings.seed)
        policy.epsilon = self.settings.epsilon
        height = width = FRAME_SIDE
        if policy.description is not None:
            preprocessing = policy.description.preprocessing
            height, width = preprocessing.frame_height, preprocessing.frame_width
        self._camera = Camera(self.settings, height, width)
        self._pilot = Pilot(policy, int(self.settings.sequence_gap * NANOSECONDS))

    def _on_image(self, message: object) -> None:
        if not self._enabled:
            return
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
        stamp = to_nanoseconds(message.header.stamp)
        try:
            answer = self._pilot.answer(
                stamp, self._camera.frame(message), time.monotonic_ns())
        except BridgeError as error:
            raise MessageError(str(error)) from None
        self._last_image, self._halted, self._stale = time.monotonic(), False, False
        self.counts['images'] += 1
        self._send(self._commands.twist(answer.command, self._pilot.elapsed / NANOSECONDS),
                   message.header.stamp)
        if answer.decided:
            self.counts['decisions'] += 1
            self._publish_values(answer, stamp)

    def _send(self, command: Command, stamp: object | None) -> None:
        if not self.settings.cmd_vel_stamped:
            self._cmd_vel.publish(fill_twist(Twist(), command))
            return
        message = TwistStamped()
        if stamp is not None:
            message.header.stamp = stamp
        message.header.frame_id = self.settings.frame_id
        fill_twist(message.twist, command)
        self._cmd_vel.publish(message)

    def _publish_values(self, answer: Answer, stamp: int) -> None:
        policy = self._pilot.policy
        values = {}
        if answer.q_values is not None:
            values.update(zip(policy.action_names, answer.q_values))
        values.update(policy.action_space.chosen(answer.action))
        values['explored'] = answer.explored
        values['weights_version'] = policy.version
        self._q_values.publish(fill_named_values(JointState(), values, stamp))

    def _halt(self) -> None:
        """Send one zero twist, stamped zero, if the last one was another."""
        if not self._halted:
            self._halted = True
            self._send(self._commands.stop(), None)

    def _watch_images(self) -> None:
        """Stop when the images have stopped."""
        if not self._halted and time.monotonic() - self._last_image > self.settings.stale_after:
            self._stale = True
            self.counts['stale_images'] += 1
            self.get_logger().warn(f'no image for {self.settings.stale_after:g} s: zero twist')
            self._halt()

    def _on_enable(
        self, request: SetBool.Request, response: SetBool.Response,
    ) -> SetBool.Response:
        self._enabled = request.data
        if not self._enabled:
            # whatever was sent before, and by whomever
            self._halted = False
            self._halt()
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled'
        self.get_logger().info(response.message)
        return response

    def _on_weights(self, message: object) -> None:
        """Swap in new weights between two decisions."""
        if self._pilot is not None and isinstance(self._pilot.policy, RandomPolicy):
            return
        try:
            description = self._pilot.policy.description if self._pilot else None
            update = decode_weights(bytes(message.data), description)
            self._newest.check(update)
            if self._pilot is None:
                self._take_policy(Policy(update.description, device=self._device))
            self._pilot.policy.swap_weights(update)
        except BridgeError as error:
            raise MessageError(str(error)) from None
        if not self.settings.explore:
            self._pilot.policy.act_greedily()
        self._pilot.policy.epsilon = (
            update.epsilon ** self.settings.epsilon_exponent if self.settings.explore
            else self.settings.epsilon)
        self.counts['weight_swaps'] += 1

    def close(self) -> None:
        """Let the car stand: a robot may hold the last twist for good."""
        if self.context.ok():
            self._halt()

    def settings_changed(self) -> None:
        """Take over a new epsilon."""
        if self._pilot is not None and not self.settings.explore:
            self._pilot.policy.epsilon = self.settings.epsilon

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what drives and how often it has answered, or why nothing drives."""
        problem = self._problem()
        level = DiagnosticStatus.OK if problem is None else DiagnosticStatus.WARN
        values: dict[str, object] = {'enabled': self._enabled}
        if self._pilot is not None:
            policy = self._pilot.policy
            values.update(
                weights_version=policy.version, epsilon=float(policy.epsilon),
                sequences=self._pilot.sequences)
            if policy.description is not None:
                values['decision_seconds'] = float(policy.description.action_seconds)
        return level, problem or 'driving', values

    def _problem(self) -> str | None:
        """Return why nothing drives, None if something does."""
        if not self._enabled:
            return 'disabled by ~/enable'
        if self._pilot is None:
            if self._weights is not None and self._weights.publishers:
                return 'waiting for weights'
            return 'waiting for weights, which nobody publishes'
        if self._stale:
            return f'stopped: no image for {time.monotonic() - self._last_image:.0f} s'
        if self._last_image is None or time.monotonic() - self._last_image > SILENCE_SECONDS:
            return self._silence()
        if not self._cmd_vel.get_subscription_count():
            return f'nobody hears {self._cmd_vel.topic_name}'
        return None

    def _silence(self) -> str:
        """Return why no image has been answered for a while."""
        name = self._images.name
        if not self._images.publishers:
            return f'no image: nobody publishes {name}'
        if len(self._images.unheard) == self._images.publishers:
            return f'no image: nothing that is published on {name} fits'
        if self.refused_lately(topics.IMAGE):
            return 'no image that can be used'
        if not self._connected:
            return f'waiting for {self.settings.wait_for_subscribers} subscriptions of cmd_vel'
        if self._last_image is None:
            return 'no image yet'
        return f'no image for {time.monotonic() - self._last_image:.0f} s'


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(DqnPolicyNode, args)


if __name__ == '__main__':
    sys.exit(main())
