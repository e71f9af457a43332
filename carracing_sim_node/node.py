# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
carracing_sim_node: CarRacing-v3 behind twists.

Purpose: publish 96x96 frames and rewards, and drive the car by the twists that answer them.

Subscribes: `cmd_vel`. Publishes: `image_raw`, `step`, `reward`, `episode`, `/clock`,
`/diagnostics`. Services: `~/reset`, `~/step` (std_srvs/Trigger), `~/pause` and `~/hold`
(std_srvs/SetBool): the car stands while people pause it or a slow learner holds it back.
Parameters: `carracing_sim_node/settings.py`.

Behaviour when things go wrong: a twist that is not finite, out of range or answers another frame
is counted in the diagnostics and logged (throttled); an unanswered frame is sent again after
`answer_timeout`, or the car coasts or holds, as `on_timeout` says; in real time a stale twist
becomes zero.
"""
from __future__ import annotations

import sys
import time

from carracing_sim_node.drive import Drive, Frame
from carracing_sim_node.errors import SimulatorError
from carracing_sim_node.settings import SimulatorSettings
from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.errors import MessageError, SettingsError
from msgs_bridge.images import fill_image
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.stamps import NANOSECONDS, set_stamp, to_nanoseconds
from msgs_bridge.twists import Command, read_command, STOP
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float32
from std_srvs.srv import SetBool, Trigger

SIMULATED_FRAMES_PER_SECOND = 50
# how long after we have seen all connections the other nodes may still be making theirs
SETTLE_SECONDS = 0.4
# what the subscribers have at the end to take the last messages
LAST_WORDS = Duration(seconds=1)


class CarRacingSimNode(NodeShell):
    """The simulator as a node; `Drive` does the driving."""

    def __init__(self) -> None:
        """Declare parameters, make the environment and wait for a driver."""
        super().__init__('carracing_sim_node', SimulatorSettings)
        settings = self.settings
        try:
            self.drive = Drive(settings)
        except SimulatorError as error:
            raise SettingsError(str(error)) from None
        self._image_publisher = self.publisher(topics.IMAGE)
        self._step_publisher = self.publisher(topics.STEP)
        self._reward_publisher = self.publisher(topics.REWARD)
        self._episode_publisher = self.publisher(topics.EPISODE)
        self._clock_publisher = self.publisher(topics.CLOCK)
        stamped = settings.cmd_vel_stamped
        self._cmd_vel = self.subscription(
            topics.CMD_VEL, self._on_stamped_twist if stamped else self._on_plain_twist,
            type_name=None if stamped else 'geometry_msgs/msg/Twist',
            eager=settings.stepping == 'lockstep')
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.serve_hold(self._on_hold)
        self._paused = settings.start_paused
        self._steps_allowed = 0
        self._frame: Frame | None = None
        self._final_stamp = -1
        self._answer: tuple[Command, int | None] | None = None
        self._held: tuple[Command, int] | None = None
        self._held_since = 0.0
        self._asked_at = 0.0
        self._decisions = self._simulated = 0
        self._rate_from = (time.monotonic(), 0, 0)
        self._ready_since: float | None = None
        self._waiting = self.create_timer(0.05, self._start_when_ready)
        self._timer = None
        self.get_logger().info(
            f'CarRacing-v3, {settings.stepping}, {self.drive.env.renderer_name} renderer')

    def _everybody_is_there(self) -> bool:
        """Return whether the driver and those who must see everything are connected."""
        wanted = self.settings.wait_for_subscribers
        driver = self.settings.stepping == 'lockstep'
        return (
            self._image_publisher.get_subscription_count() >= wanted + driver
            and self._step_publisher.get_subscription_count() >= wanted
            and (not driver or self.count_publishers(topics.CMD_VEL.name) > 0)
        )

    def _start_when_ready(self) -> None:
        """Publish the first frame once those who must see it have been there for a moment."""
        now = time.monotonic()
        if not self._everybody_is_there():
            self._ready_since = None
            self.get_logger().info(
                'waiting for a driver (a subscription of image_raw, a publisher of cmd_vel) and '
                f'{self.settings.wait_for_subscribers} more subscriptions of image_raw and step',
                throttle_duration_sec=10.0)
            return
        if self._ready_since is None:
            self._ready_since = now
        if now - self._ready_since < SETTLE_SECONDS:
            return
        self._waiting.cancel()
        self._begin_episode()
        if self.settings.stepping == 'lockstep':
            self._timer = self.create_timer(0.05, self._watch_answer)
        else:
            period = self.settings.action_repeat / (
                SIMULATED_FRAMES_PER_SECOND * self.settings.real_time_factor)
            self._timer = self.create_timer(period, self._tick)

    def _begin_episode(self) -> None:
        if self.drive.finished:
            self.get_logger().info(f'{self.settings.episodes} episodes driven')
            raise Finished
        self._answer = None
        self._publish(self.drive.begin())

    def _publish(self, frame: Frame) -> None:
        """Publish one frame; the image goes first, so that the policy thinks meanwhile."""
        self._frame = frame
        self._send_image(frame)
        clock = Clock()
        set_stamp(clock.clock, frame.stamp)
        self._clock_publisher.publish(clock)
        self._step_publisher.publish(fill_named_values(JointState(), frame.facts, frame.stamp))
        self._reward_publisher.publish(Float32(data=float(frame.facts['reward'])))
        if frame.ended:
            self._final_stamp = frame.stamp
        if frame.summary is not None:
            self._episode_publisher.publish(
                fill_named_values(JointState(), frame.summary, frame.stamp))

    def _send_image(self, frame: Frame) -> None:
        self._asked_at = time.monotonic()
        self._image_publisher.publish(
            fill_image(Image(), frame.pixels, frame.stamp, self.settings.frame_id))

    def _advance(self, command: Command, applied_stamp: int | None) -> None:
        """Drive one decision, publish it, and start the next episode after the last frame."""
        self._answer = None
        frame = self.drive.advance(command, applied_stamp)
        self._decisions += 1
        self._simulated += int(frame.facts['frames'])
        self._publish(frame)
        if frame.ended:
            self._begin_episode()

    def _may_step(self) -> bool:
        if self.held_back:
            return False
        if not self._paused:
            return True
        if self._steps_allowed:
            self._steps_allowed -= 1
            return True
        return False

    def _on_stamped_twist(self, message: object) -> None:
        self._take_twist(message.twist, to_nanoseconds(message.header.stamp))

    def _on_plain_twist(self, message: object) -> None:
        if self._frame is not None:
            self._take_twist(message, self._frame.stamp)

    def _take_twist(self, twist: object, stamp: int) -> None:
        given = read_command(twist)
        command = given.clamped()
        self.counts['clamped_twists'] += command != given
        if self._frame is None:
            return
        if self.settings.stepping == 'real_time':
            self._held, self._held_since = (command, stamp), time.monotonic()
            return
        if stamp != self._frame.stamp:
            # an answer to the last frame of an episode, or a watchdog's zero twist, is no fault
            if stamp not in (self._final_stamp, 0):
                raise MessageError(
                    f'twist answers {stamp / NANOSECONDS:.2f} s; '
                    f'waiting for {self._frame.stamp / NANOSECONDS:.2f} s')
            return
        if self._answer is None:
            self._held = self._answer = (command, stamp)
        self._go_on()

    def _go_on(self) -> None:
        if self._answer is not None and self._may_step():
            self._advance(*self._answer)

    def _watch_answer(self) -> None:
        """Lockstep: do as `on_timeout` says when nobody has answered in time."""
        if self._answer is not None or self._paused or self.held_back:
            return
        if time.monotonic() - self._asked_at < self.settings.answer_timeout:
            return
        choice = self.settings.on_timeout
        self.counts['answer_timeouts'] += 1
        self.get_logger().warn(
            f'no twist on cmd_vel has answered the frame of '
            f'{self._frame.stamp / NANOSECONDS:.2f} s for '
            f'{self.settings.answer_timeout:g} s; on_timeout: {choice}',
            throttle_duration_sec=5.0)
        if choice == 'resend':
            self._send_image(self._frame)
        elif choice == 'hold' and self._held is not None:
            self._advance(*self._held)
        else:
            self._advance(STOP, None)

    def _tick(self) -> None:
        """Real time: drive on by the twist that is held."""
        if not self._may_step():
            return
        if self._held is not None:
            if time.monotonic() - self._held_since <= self.settings.stale_after:
                command, stamp = self._held
                self._advance(command, stamp or None)
                return
            self._held = None
            self.counts['stale_twists'] += 1
            self.get_logger().warn(
                f'no twist for {self.settings.stale_after:g} s: coasting',
                throttle_duration_sec=5.0)
        self._advance(STOP, None)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._frame is None:
            response.message = 'not started: nobody drives yet'
            return response
        self._held = None
        self._begin_episode()
        response.success = True
        response.message = f'episode {self.drive.episode}'
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._paused:
            response.message = 'not paused: call ~/pause with true first'
            return response
        self._steps_allowed += 1
        if self.settings.stepping == 'lockstep' and self._frame is not None:
            self._go_on()
        response.success = True
        response.message = f'{self._steps_allowed} steps waiting for an answer'
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        self._steps_allowed = 0
        if not self._paused:
            self._wait_anew()
        response.success = True
        response.message = 'paused' if self._paused else 'running'
        return response

    def _on_hold(self) -> None:
        if not self.held_back:
            self._wait_anew()

    def _wait_anew(self) -> None:
        """Go on after standing still, which does not count as time without an answer."""
        self._asked_at = time.monotonic()
        self._go_on()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return rates and what the node waits for."""
        now = time.monotonic()
        since, decisions, simulated = self._rate_from
        elapsed = max(now - since, 1e-9)
        self._rate_from = (now, self._decisions, self._simulated)
        values = {
            'decisions_per_second': (self._decisions - decisions) / elapsed,
            'simulated_frames_per_second': (self._simulated - simulated) / elapsed,
            'episode': self.drive.episode,
            'renderer': self.drive.env.renderer_name,
            'paused': self._paused,
            'held_back': self.held_back,
        }
        if self._frame is None:
            return DiagnosticStatus.WARN, 'waiting for a driver', values
        if self._paused:
            return DiagnosticStatus.OK, 'paused', values
        if self.held_back:
            return DiagnosticStatus.OK, 'held back by a learner', values
        late = now - self._asked_at > self.settings.answer_timeout
        if late and self.settings.stepping == 'lockstep':
            return DiagnosticStatus.WARN, 'waiting for a twist', values
        return DiagnosticStatus.OK, 'driving', values

    def close(self) -> None:
        """Let the last frame arrive, then let go of the environment."""
        for publisher in (self._step_publisher, self._image_publisher, self._episode_publisher):
            try:
                publisher.wait_for_all_acked(LAST_WORDS)
            except Exception:
                # a signal shuts ROS down at any moment, and then there is nobody left to wait for
                if self.context.ok():
                    raise
        self.drive.env.close()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(CarRacingSimNode, args)


if __name__ == '__main__':
    sys.exit(main())
