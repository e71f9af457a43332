# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
trainer_node: transitions in, better weights out.

Purpose: join `image_raw`, `step` and `cmd_vel` into transitions, learn from them, publish weights.
Images and twists go through the same camera and scale as those of the policy.

Subscribes: `image_raw`, `step`, `cmd_vel`, `validation`. Publishes: `weights`, `/diagnostics`.
Services: `~/save`, `~/evaluate` (std_srvs/Trigger). Calls: `~/hold` of the simulator, if it has
that.
Parameters: `trainer_node/settings.py`, hyperparameters in `trainer_node/hyperparameters.py`.

Behaviour when things go wrong: a message that cannot be used is counted and logged (throttled); a
transition with a lost part is dropped and counted; when nothing can be joined, the diagnostics
name the topic that is to blame. On any signal everything is saved and what waits is dropped; a
loss that is not finite, or a step that lacks what a shaping term needs, ends learning, and the
checkpoint of before is kept. The log says where, or that it could not be saved (seed document
4.2.2).
"""
from __future__ import annotations

from array import array
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.camera import Camera
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import read_step, VALIDATION_FIELDS
from msgs_bridge.twists import read_command
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger
from trainer_node.driver import Driver
from trainer_node.open_run import open_training, read_overrides, run_settings
from trainer_node.settings import TrainerSettings
from trainer_node.source import Source

# Messages are taken topic by topic in rounds, so that no topic runs far ahead of the others.
TAKEN_AT_ONCE = 20
ROUNDS = 10

# How long the learning thread sleeps when nothing has come in.
IDLE_SECONDS = 0.0005


class TrainerNode(NodeShell):
    """
    The trainer as a node.

    The learning thread owns `training`. Between two transitions it takes the messages that have
    come in itself, because an executor that wakes for each of a thousand messages a second halves
    the rate of updates. The ROS thread has the rare things: services, validations, diagnostics.
    """

    def __init__(self) -> None:
        """Declare parameters, create or resume the run and start to learn."""
        super().__init__('trainer_node', TrainerSettings)
        settings = self.settings
        training = open_training(
            settings.run, run_settings(
                settings.run, settings.preset,
                read_overrides(filter(None, settings.overrides.split(','))),
                resume=settings.resume),
            resume=settings.resume, device=settings.device, tensorboard=settings.tensorboard)
        preprocessing = training.description.preprocessing
        self._camera = Camera(
            settings, preprocessing.frame_height, preprocessing.frame_width)
        self._source = Source(settings.queue_limit)
        self._failure: Exception | None = None
        self._holding = False
        self._stopping = threading.Event()
        self._weights_publisher = self.publisher(topics.WEIGHTS)
        self._inputs = (
            self.subscription(
                topics.IMAGE, self._on_image, depth=topics.STALL_DEPTH, polled=True,
                type_name='sensor_msgs/msg/CompressedImage'
                if settings.camera_compressed else None),
            self.subscription(topics.STEP, self._on_step, polled=True),
            self.subscription(topics.CMD_VEL, self._on_twist, polled=True))
        self.subscription(topics.VALIDATION, self._on_validation)
        self.create_service(Trigger, '~/save', self._on_save)
        self.create_service(Trigger, '~/evaluate', self._on_evaluate)
        self._hold = self.create_client(SetBool, f'{settings.simulator}/hold')
        self._learner_called = self.create_guard_condition(self._on_learner)
        self._driver = Driver(
            training, self._publish_weights, say=self.get_logger().info,
            warn=lambda text: self.warn_of('learning', text),
            last_validation_seconds=settings.last_validation_seconds)
        self._learning = threading.Thread(target=self._learn, name='learning')
        self._learning.start()
        self.get_logger().info(f'learning into {settings.run}')

    # --- ROS thread

    def _on_validation(self, message: object) -> None:
        self._driver.validated(read_named_values(message, VALIDATION_FIELDS))

    def _on_learner(self) -> None:
        """Answer the learning thread, which is complete or has failed."""
        if self._failure is not None:
            raise BridgeError(f'learning stopped: {self._failure}') from self._failure
        if self._driver.done:
            raise Finished

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._driver.request_save()
        response.success = True
        response.message = f'saving into {self.settings.run}'
        return response

    def _on_evaluate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._driver.request_validation()
        response.success = True
        response.message = 'weights go out for validation; the result comes on validation'
        return response

    # --- learning thread: messages to transitions

    def _on_image(self, message: object) -> None:
        frame = self._camera.frame(message)
        if len(message.data) > 2 * frame.nbytes:
            # a part of a large image would keep all of it in memory
            frame = frame.copy()
        self._put(self._source.add_image(to_nanoseconds(message.header.stamp), frame))

    def _on_step(self, message: object) -> None:
        step = read_step(read_named_values(message))
        self._put(self._source.add_step(to_nanoseconds(message.header.stamp), step))

    def _on_twist(self, message: object) -> None:
        command = self.settings.from_robot(read_command(message.twist))
        self._put(self._source.add_twist(to_nanoseconds(message.header.stamp), command))

    def _put(self, complete: bool) -> None:
        if not complete:
            # a simulator without ~/hold, or a bag played too fast
            self.warn_of('transitions', 'they come faster than they are learned from and nobody '
                         f'answers {self.settings.simulator}/hold: some are dropped')

    def _take_messages(self) -> None:
        """Take what has come in, topic by topic, and hold the simulator back or let it go on."""
        for _ in range(ROUNDS):
            taken = 0
            for subscription in self._inputs:
                for _ in range(TAKEN_AT_ONCE):
                    if not self.take(subscription):
                        break
                    taken += 1
            if not taken:
                break
        self._source.looked()
        hold = self._source.should_hold(self._holding)
        if hold != self._holding:
            self._set_hold(hold)

    def _set_hold(self, hold: bool) -> None:
        """Hold the simulator back, or let it go on: the limiter of the replay ratio."""
        if not self.context.ok() or not self._hold.service_is_ready():
            return
        self._holding = hold
        self.counts['held_back'] += hold
        self._hold.call_async(SetBool.Request(data=hold))

    # --- learning thread: transitions to weights

    def _learn(self) -> None:
        try:
            self._learn_until_stopped()
        except Exception as error:  # the failsafe must see every kind of error
            self._failure = error
            self.get_logger().error(f'learning stopped: {type(error).__name__}: {error}')
        self._learner_called.trigger()

    def _learn_until_stopped(self) -> None:
        driver = self._driver
        # on stop what waits is dropped: learning from it would take the time to save
        while not self._stopping.is_set():
            self._take_messages()
            transition = self._source.take()
            if transition is not None:
                driver.add(transition)
            else:
                time.sleep(IDLE_SECONDS)
            if not driver.turn():
                break

    def _publish_weights(self, data: bytes) -> None:
        """Send the next version of the weights."""
        if self.context.ok():
            message = UInt8MultiArray()
            # array('B') is copied at once; a list would be copied byte by byte
            message.data = array('B', data)
            self._weights_publisher.publish(message)

    # --- both

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return the state of learning and of the joiner, or why nothing is learned."""
        values = {**self._driver.status, **self._source.figures(), 'holding': self._holding}
        if self._failure is not None:
            return DiagnosticStatus.ERROR, f'failed: {self._failure}', values
        problem = self._silence() or self._source.losses()
        if problem:
            return DiagnosticStatus.WARN, problem, values
        return DiagnosticStatus.OK, 'learning', values

    def _silence(self) -> str:
        """Return why nothing can be joined, '' if something is."""
        topic = self._source.silent_topic
        if not topic or self._driver.ended:
            return ''
        subscription = dict(zip(
            (topics.IMAGE.name, topics.STEP.name, topics.CMD_VEL.name), self._inputs))[topic]
        if not subscription.publishers:
            return f'no {topic}: nobody publishes {subscription.name}'
        if len(subscription.unheard) == subscription.publishers:
            return f'no {topic}: nothing that is published on {subscription.name} fits'
        if self.counts[f'rejected_{topic}'] and not self._source.joiner.counts['joined']:
            return f'no {topic} that can be used'
        waiting = self._source.joiner.waiting
        if waiting:
            return f'no {topic} with the stamp of the oldest of {waiting} steps that wait for it'
        return f'no {topic} at the moment'

    def close(self) -> None:
        """Finish the update under way, then save everything or say that it could not be."""
        self._stopping.set()
        self._learning.join()
        training = self._driver.training
        if training.failed:
            sys.stderr.write(f'kept {training.folder.checkpoint}, of before learning failed\n')
            return
        try:
            sys.stderr.write(f'saved {self._driver.close()}\n')
        except BridgeError as error:
            sys.stderr.write(f'error: the run could NOT be saved: {error}\n')


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped or the run is complete."""
    return run_node(TrainerNode, args)


if __name__ == '__main__':
    sys.exit(main())
