# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The node around any simulator: frames and rewards out, twists in.

Purpose: publish what a `Simulator` shows and earns, and drive it by the twists that answer.

Subscribes: `cmd_vel`. Publishes: `image_raw`, `step`, `reward`, `episode`, `/clock`,
`/diagnostics`. Services: `~/reset`, `~/step` (std_srvs/Trigger), `~/pause` and `~/hold`
(std_srvs/SetBool): the simulator stands while people pause it or a slow learner holds it back.
Parameters: `carracing_dqn/simulation/settings.py` and the settings of the simulator.

Behaviour when things go wrong: a twist that is not finite, whose stamp is none or that answers
another frame is counted in the diagnostics and logged (throttled), one out of range is clamped
and counted; an unanswered frame is sent again after `answer_timeout`, or the car coasts or holds,
as `on_timeout` says; in real time a stale twist becomes zero; where somebody publishes /clock
already, this node does not; a simulator that cannot go on ends the node with one line and code 2,
and so does one that has not come back ten seconds after the node was stopped.
Wall time decides about all of it, so that `use_sim_time` changes nothing.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
import functools
import os
import threading
import time

from carracing_dqn.simulation.checks import let_go_of
from carracing_dqn.simulation.drive import Frame, make_drive
from carracing_dqn.simulation.registry import DEFAULT
from carracing_dqn.simulation.settings import node_settings
from carracing_dqn.simulation.stepping import Lockstep, RealTime
from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.images import fill_compressed_image, fill_image
from msgs_bridge.last_line import say
from msgs_bridge.matching import publishers_of
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import Finished, NodeShell
from msgs_bridge.plain_text import plain
from msgs_bridge.stamps import NANOSECONDS, set_stamp, to_nanoseconds
from msgs_bridge.twists import read_command
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Float32
from std_srvs.srv import SetBool, Trigger

# how often to look whether everybody is there, and whether an answer is overdue
BEAT_SECONDS = 0.05
# of each such look, how long to pass over the episodes before the first
SKIP_SECONDS = 0.03
# how long after we have seen all connections the other nodes may still be making theirs
SETTLE_SECONDS = 0.4
# characters of what a simulator says of itself
LONGEST_DESCRIPTION = 300
# what the subscribers have at the end to take the last messages
LAST_WORDS = Duration(seconds=1)
# what a simulator has, once the node is to end, to come back from whatever it does, and how often
# to look whether it is
PATIENCE_SECONDS = 10.0
LOOK_SECONDS = 0.5


class SimulatorNode(NodeShell):
    """
    A simulator as a node; `Drive` does the driving, `Stepping` says when.

    Attributes:
        drive: the episodes.
        must_arrive: publishers whose last message is waited for at the end.
    """

    def __init__(self, name: str = 'simulator_node', simulator: str = DEFAULT) -> None:
        """
        Declare the parameters, make the simulator and wait for a driver.

        Args:
            name: of the node.
            simulator: which one it is if its parameters do not say.

        Raises:
            SettingsError: a parameter that is unknown or not accepted.
            SimulatorError: no such simulator, or it cannot run here.
        """
        super().__init__(name, functools.partial(node_settings, simulator=simulator))
        self._closing, self._gone = threading.Event(), threading.Event()
        threading.Thread(target=self._end_anyway, name='patience', daemon=True).start()
        self.drive = make_drive(self.settings)
        with let_go_of(self.drive.simulator):
            self._join_graph()

    def _join_graph(self) -> None:
        """Create what others see of the node, and wait for a driver."""
        settings = self.settings
        self._lockstep = settings.stepping == 'lockstep'
        self._stepping = (Lockstep if self._lockstep else RealTime)(self.drive, self)
        self._image_publisher = self.publisher(
            topics.IMAGE, type_name=topics.COMPRESSED_TYPE if settings.image_compressed else None)
        self.must_arrive = (self._image_publisher, *self.open_outlets())
        self._clock_publisher = None
        stamped = settings.cmd_vel_stamped
        self._cmd_vel = self.subscription(
            topics.CMD_VEL, self._on_stamped_twist if stamped else self._on_plain_twist,
            type_name=None if stamped else topics.PLAIN_TWIST_TYPE, eager=self._lockstep)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.serve_hold(lambda: self._attempt(lambda: self._stepping.hold(self.held_back)))
        self._failure: BridgeError | None = None
        self._rate_from = (time.monotonic(), 0, 0)
        self._ready_since: float | None = None
        self._timer = self.create_timer(BEAT_SECONDS, self._start_when_ready)
        # of somebody's class
        told = plain(self.drive.simulator.description or settings.simulator, LONGEST_DESCRIPTION)
        self.get_logger().info(f'{told}, {settings.stepping}')

    def _end_anyway(self) -> None:
        """End the process where the simulator, somebody's code, does not come back in time."""
        while self.context.ok() and not self._closing.wait(LOOK_SECONDS):
            pass
        if not self._gone.wait(PATIENCE_SECONDS):
            say(f'error: simulator {plain(self.settings.simulator)!r} has not come back for '
                f'{PATIENCE_SECONDS:g} s: ended without it')
            os._exit(2)

    def open_outlets(self) -> Sequence[Publisher]:
        """
        Create the publishers of what a simulator says beside its image.

        Returns:
            those whose last message must arrive; before the first frame the subscriptions of the
            first of them are waited for, too.
        """
        self._step_publisher = self.publisher(topics.STEP)
        self._reward_publisher = self.publisher(topics.REWARD)
        self._episode_publisher = self.publisher(topics.EPISODE)
        return self._step_publisher, self._episode_publisher

    def _start_when_ready(self) -> None:
        """Publish the first frame once those who must see it have been there for a moment."""
        left = self.drive.skip_for(SKIP_SECONDS)
        if left:
            self.get_logger().info(
                f'passing over {left} more episodes of the stream', throttle_duration_sec=10.0)
            return
        now = time.monotonic()
        if not self._everybody_is_there():
            self._ready_since = None
            self.get_logger().info(f'waiting for {self._awaited()}', throttle_duration_sec=10.0)
            return
        if self._ready_since is None:
            self._ready_since = now
        if now - self._ready_since < SETTLE_SECONDS:
            return
        self._timer.cancel()
        if self.settings.publish_clock:
            if self.count_publishers(self.resolve_topic_name(topics.CLOCK.name)):
                self.get_logger().warn('another node publishes /clock: this one does not')
            else:
                self._clock_publisher = self.publisher(topics.CLOCK)
        self._stepping.start()
        period = BEAT_SECONDS
        if not self._lockstep:
            period = (self.settings.action_repeat * self.drive.simulator.frame_seconds
                      / self.settings.real_time_factor)
        self._timer = self.create_timer(period, self._beat)

    def _everybody_is_there(self) -> bool:
        """Return whether the driver and those who must see everything are connected."""
        wanted = self.settings.wait_for_subscribers
        return (
            self._image_publisher.get_subscription_count() >= wanted + self._lockstep
            and all(one.get_subscription_count() >= wanted for one in self.must_arrive[1:2])
            and (not self._lockstep or self._cmd_vel.matched > 0)
        )

    def _awaited(self) -> str:
        """Return who has to be there before the first frame, in words."""
        wanted = []
        if self._lockstep:
            wanted.append('a driver (a subscription of image_raw, a publisher of cmd_vel)')
        if self.settings.wait_for_subscribers:
            more = 'more ' if self._lockstep else ''
            wanted.append(f'{self.settings.wait_for_subscribers} {more}subscriptions of image_raw '
                          'and step')
        return ' and '.join(wanted)

    def _beat(self) -> None:
        if self._failure is not None:
            raise self._failure
        if not self._stepping.finished:
            self._stepping.beat()
        if self._stepping.finished:
            self.get_logger().info(f'{self.settings.episodes} episodes driven')
            raise Finished

    def send_frame(self, frame: Frame) -> None:
        """Publish one frame; the image goes first, so that the policy thinks meanwhile."""
        self.send_again(frame)
        self.send_clock(frame.stamp)
        step = frame.step
        if frame.episode is not None and not step.ended:
            self.send_episode(frame.episode, frame.stamp)
        self._step_publisher.publish(fill_named_values(JointState(), step.values(), frame.stamp))
        self._reward_publisher.publish(Float32(data=float(step.reward)))
        if frame.episode is not None and step.ended:
            self.send_episode(frame.episode, frame.stamp)

    def send_clock(self, stamp: int) -> None:
        """Publish what time it is, if this node is the one that does."""
        if self._clock_publisher is not None:
            clock = Clock()
            set_stamp(clock.clock, stamp)
            self._clock_publisher.publish(clock)

    def send_again(self, frame: Frame) -> None:
        """Publish the image of a frame."""
        message, fill = Image(), fill_image
        if self.settings.image_compressed:
            message, fill = CompressedImage(), fill_compressed_image
        self._image_publisher.publish(
            fill(message, frame.pixels, frame.stamp, self.settings.frame_id))

    def send_episode(self, values: dict[str, float], stamp: int) -> None:
        """Publish that an episode begins or has ended."""
        self._episode_publisher.publish(fill_named_values(JointState(), values, stamp))

    def warn(self, text: str) -> None:
        """Log a warning, throttled."""
        self.get_logger().warn(text, throttle_duration_sec=5.0)

    def _on_stamped_twist(self, message: object) -> None:
        stamp = message.header.stamp
        if stamp.sec < 0 or stamp.nanosec >= NANOSECONDS:
            raise MessageError(f'twist with a stamp of {stamp.sec} s and {stamp.nanosec} ns')
        self._take_twist(message.twist, to_nanoseconds(stamp))

    def _on_plain_twist(self, message: object) -> None:
        self._take_twist(message, None)

    def _take_twist(self, twist: object, stamp: int | None) -> None:
        given = read_command(twist)
        command = given.clamped()
        self.counts['clamped_twists'] += command != given
        self._stepping.take(command, stamp)

    def _attempt(self, act: Callable[[], object]) -> tuple[bool, str]:
        """
        Do something for a service; return whether it could be done, and what to say of it.

        Who has called gets an answer, whatever comes of it; what ends the node comes after.
        """
        try:
            result = act()
        except BridgeError as error:
            self._failure = error
            return False, str(error)
        return result if isinstance(result, tuple) else (True, str(result))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._attempt(self._stepping.reset)
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._attempt(self._stepping.step)
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = self._attempt(
            lambda: self._stepping.pause(request.data))
        return response

    def _share_clock(self) -> None:
        """Leave /clock to one of several that began at the same time."""
        if self._clock_publisher is None:
            return
        publishers = publishers_of(self, topics.CLOCK.name)
        first = min(publishers, key=lambda one: list(one.endpoint_gid), default=None)
        ours = (self.get_name(), self.get_namespace())
        if first is not None and (first.node_name, first.node_namespace) != ours:
            self.get_logger().warn('another node publishes /clock, too: this one stops')
            self.destroy_publisher(self._clock_publisher)
            self._clock_publisher = None

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return rates and what the node waits for."""
        self._share_clock()
        stepping, now = self._stepping, time.monotonic()
        since, decisions, simulated = self._rate_from
        elapsed = max(now - since, 1e-9)
        self._rate_from = (now, stepping.decisions, stepping.simulated)
        values = {
            'decisions_per_second': (stepping.decisions - decisions) / elapsed,
            'simulated_frames_per_second': (stepping.simulated - simulated) / elapsed,
            'episode': self.drive.episode,
            'simulator': self.settings.simulator,
            'description': self.drive.simulator.description,
            'paused': stepping.paused,
            'held_back': self.held_back,
            'publishes_clock': self._clock_publisher is not None,
        }
        if stepping.frame is None:
            return DiagnosticStatus.WARN, f'waiting for {self._awaited() or "the start"}', values
        if stepping.paused:
            return DiagnosticStatus.OK, 'paused', values
        if self.held_back:
            return DiagnosticStatus.OK, 'held back by a learner', values
        if self._lockstep and stepping.unanswered:
            return DiagnosticStatus.WARN, 'waiting for a twist', values
        return DiagnosticStatus.OK, 'driving', values

    def close(self) -> None:
        """Let the last frame arrive, then let go of the simulator."""
        self._closing.set()
        for publisher in self.must_arrive:
            try:
                publisher.wait_for_all_acked(LAST_WORDS)
            except Exception:
                # a signal shuts ROS down at any moment, and then there is nobody left to wait for
                if self.context.ok():
                    raise
        self.drive.close()

    def destroy_node(self) -> None:
        """Leave the graph; nothing of the simulator is waited for any more."""
        self._gone.set()
        super().destroy_node()
