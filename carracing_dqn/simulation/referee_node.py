# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
referee_node: the rewards and the ends of a robot that has none.

Purpose: publish `step` and `episode` for the images of a robot, judged by topics that robots have,
so that trainer_node learns from it.

Subscribes: `image_raw` (its stamps), `cmd_vel` (TwistStamped, with the stamps of the images that
it answers), and of `odom`, `path`, `collision`, `lane_offset` and `goal_distance` those that a
term needs. Publishes: `step`, `reward`, `episode`, `/diagnostics`. Services: `~/reset`
(std_srvs/Trigger) cuts the episode off. Calls: `reset_service` of the robot after each episode.
Parameters: `carracing_dqn/simulation/referee_settings.py`.

Behaviour when things go wrong: frames for which something is missing get no step, and log and
diagnostics name the topic and the term that needs it; numbers that are not finite are counted and
logged (throttled); a reset that is refused or not answered is asked for again.
"""
from __future__ import annotations

import functools
import sys
import time

from carracing_dqn.simulation.referee import (
    COLLISION, GOAL, Judgement, KEPT, LANE_OFFSET, MOST_AGAIN, ODOM, Pose, Referee, THE_PATH,
    yaw_of,
)
from carracing_dqn.simulation.referee_settings import RefereeSettings
from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.adaptive_subscription import AdaptiveSubscription
from msgs_bridge.errors import MessageError, SettingsError
from msgs_bridge.named_values import fill_named_values
from msgs_bridge.node_shell import NodeShell, run_node
from msgs_bridge.stamps import NANOSECONDS, to_nanoseconds
from msgs_bridge.twists import read_command
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

# how often frames that wait for something are looked at again; s
BEAT_SECONDS = 0.01
# planners send paths of thousands of points many times a second: after one has been read none is
# for so many times as long as that took
PATH_PAUSE = 9.0
# without an image for so long it is told, s
SILENCE_SECONDS = 2.0


class RefereeNode(NodeShell):
    """Hears a robot and says what `Referee` makes of it."""

    def __init__(self) -> None:
        """
        Declare the parameters and subscribe to what is needed.

        Raises:
            SettingsError: a parameter that is unknown or not accepted.
        """
        super().__init__('referee_node', RefereeSettings)
        settings = self.settings
        self._referee = Referee(settings)
        self._step_publisher = self.publisher(topics.STEP)
        self._reward_publisher = self.publisher(topics.REWARD)
        self._episode_publisher = self.publisher(topics.EPISODE)
        heard = {ODOM: (topics.ODOMETRY, self._on_odometry),
                 THE_PATH: (topics.PATH, self._on_path),
                 COLLISION: (topics.COLLISION, self._on_collision),
                 LANE_OFFSET: (topics.LANE_OFFSET, self._number_of(LANE_OFFSET)),
                 GOAL: (topics.GOAL_DISTANCE, self._number_of(GOAL))}
        # taken with each image, whichever of them the executor would call first
        self._inputs = {
            name: self.subscription(*heard[name], polled=True) for name in self._referee.needed}
        self._path_again_at = 0.0
        self._twists = self.subscription(topics.CMD_VEL, self._on_twist, polled=True)
        self._image_at: float | None = None
        self._images = self.subscription(
            topics.IMAGE, self._on_image,
            type_name=topics.COMPRESSED_TYPE if settings.camera_compressed else None)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self._reset = None
        if settings.reset_service:
            try:
                self._reset = self.create_client(Trigger, settings.reset_service)
            except Exception as error:
                # rclpy has a class of its own for each way in which a name is none
                raise SettingsError(f'reset_service: {error}'.splitlines()[0]) from None
        self._asked_again_at = 0.0
        self._asked: object = None
        self._open = settings.wait_for_subscribers == 0
        self.create_timer(BEAT_SECONDS, self._beat)
        self.get_logger().info(
            f'judging by {", ".join(self._referee.needed) or "nothing but time"}')

    def _on_image(self, message: object) -> None:
        stamp = _stamp_of(message)
        if not stamp:
            # which says none, as everywhere in ROS
            raise MessageError('an image without a stamp: no frame can be told from another; the '
                               'camera has to stamp them')
        self._image_at = time.monotonic()
        if self._open:
            self._take_inputs()
            self._referee.see_image(stamp, time.monotonic())
            self._beat()

    def _on_twist(self, message: object) -> None:
        self._referee.hear_twist(_stamp_of(message), read_command(message.twist))

    def _on_odometry(self, message: object) -> None:
        pose = message.pose.pose
        turn = pose.orientation
        yaw = yaw_of(turn.x, turn.y, turn.z, turn.w)
        self._referee.hear_odometry(
            _stamp_of(message), Pose(pose.position.x, pose.position.y, yaw),
            message.header.frame_id)

    def _on_path(self, message: object) -> None:
        points = [(one.pose.position.x, one.pose.position.y) for one in message.poses]
        self._referee.hear_path(np.array(points, float).reshape(-1, 2), message.header.frame_id)

    def _on_collision(self, message: object) -> None:
        self._referee.hear_collision(message.data)

    def _number_of(self, topic: str) -> object:
        def hear(message: object) -> None:
            self._referee.hear_number(topic, message.data, time.monotonic())
        return hear

    def _beat(self) -> None:
        """Take what has come and say what can be said."""
        if not self._open:
            self._open = (self._step_publisher.get_subscription_count()
                          >= self.settings.wait_for_subscribers)
            return
        self._take_inputs()
        referee = self._referee
        referee.published = {name for name, one in self._inputs.items() if one.matched}
        for judgement in referee.judge(time.monotonic()):
            self._send(judgement)
        for topic, text in referee.missing.items():
            self.warn_of(topic, text)
        if referee.resetting:
            self._ask_for_reset()

    def _take_inputs(self) -> None:
        for name, subscription in (*self._inputs.items(), (topics.CMD_VEL.name, self._twists)):
            if name == THE_PATH:
                self._take_path(subscription)
                continue
            # bounded, for messages may come faster than they are taken
            for _ in range(KEPT):
                if not self.take(subscription):
                    break

    def _take_path(self, subscription: AdaptiveSubscription) -> None:
        before = time.monotonic()
        if before >= self._path_again_at and self.take(subscription):
            now = time.monotonic()
            self._path_again_at = now + PATH_PAUSE * (now - before)

    def _send(self, judgement: Judgement) -> None:
        stamp, step, episode = judgement.stamp, judgement.step, judgement.episode
        send_episode = functools.partial(
            self._episode_publisher.publish,
            episode and fill_named_values(JointState(), episode, stamp))
        if episode is not None and step is not None and not step.ended:
            send_episode()
        if step is not None:
            self._step_publisher.publish(fill_named_values(JointState(), step.values(), stamp))
            self._reward_publisher.publish(Float32(data=float(step.reward)))
        if episode is not None and (step is None or step.ended):
            send_episode()

    def _ask_for_reset(self) -> None:
        now = time.monotonic()
        if now < self._asked_again_at:
            return
        self._asked_again_at = now + self.settings.reset_retry
        if not self._reset.service_is_ready():
            self.warn_of('reset_service', f'{self.settings.reset_service} is not there')
            # it may come at any moment
            self._asked_again_at = now + 0.1
            return
        if self._asked is not None:
            self.warn_of('reset_service', 'it did not answer: asking again')
            self._reset.remove_pending_request(self._asked)
        self._asked = self._reset.call_async(Trigger.Request())
        self._asked.add_done_callback(self._on_reset_answer)

    def _on_reset_answer(self, future: object) -> None:
        answer = future.result()
        self._asked = None
        if answer is None:
            return
        if answer.success:
            self.counts['resets'] += 1
            self._asked_again_at = 0.0
            self._referee.reset_done()
        else:
            self.warn_of('reset_service', f'refused: {answer.message}')

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        judgement = self._referee.cut_off()
        response.success = judgement is not None
        response.message = 'no episode is running'
        if judgement is not None:
            self._send(judgement)
            response.message = f'episode {self._referee.episode} is cut off'
        return response

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return what is judged and what it waits for."""
        referee = self._referee
        values = {'episode': referee.episode, 'judges_by': ', '.join(referee.needed),
                  **referee.counts}
        if not self._open:
            return DiagnosticStatus.WARN, 'waiting for subscriptions of step', values
        unpublished = [name for name, one in self._inputs.items() if not one.matched]
        if unpublished:
            told = '; '.join(f'{name}: nobody publishes it, {referee.needed[name]} needs it'
                             for name in unpublished)
            return DiagnosticStatus.WARN, f'not judging: {told}', values
        silence = self._silence()
        if referee.resetting and not silence:
            return DiagnosticStatus.OK, 'waiting for the reset of the robot', values
        if referee.again >= MOST_AGAIN:
            return DiagnosticStatus.WARN, (
                f'not judging: {referee.again} images in a row bear one stamp: a camera whose '
                'stamps stand, or a simulator that waits for its driver'), values
        if silence:
            return DiagnosticStatus.WARN, f'not judging: {silence}', values
        if referee.jumps >= MOST_AGAIN:
            return DiagnosticStatus.WARN, (
                f'every image cuts its episode off: {referee.jumps} in a row are later than '
                f'sequence_gap, {self.settings.sequence_gap:g} s, or go back: a slow camera needs '
                'a longer one'), values
        if not referee.running:
            return DiagnosticStatus.OK, 'waiting for the next episode', values
        return DiagnosticStatus.OK, 'judging', values

    def _silence(self) -> str:
        """Return what is to be said of images that do not come; empty while they do."""
        if not self._images.publishers:
            return f'no image: nobody publishes {self._images.name}'
        if self._image_at is None:
            return 'no image yet'
        silent = time.monotonic() - self._image_at
        return f'no image for {silent:.0f} s' if silent > SILENCE_SECONDS else ''


def _stamp_of(message: object) -> int:
    stamp = message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= NANOSECONDS:
        raise MessageError(f'a stamp of {stamp.sec} s and {stamp.nanosec} ns')
    return to_nanoseconds(stamp)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(RefereeNode, args)


if __name__ == '__main__':
    sys.exit(main())
