# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
trainer_node: transitions in, better weights out.

Purpose: join `image_raw`, `step` and `cmd_vel` into transitions, learn from them, publish weights.

Subscribes: `image_raw`, `step`, `cmd_vel`, `validation`. Publishes: `weights`, `/diagnostics`.
Services: `~/save`, `~/evaluate` (std_srvs/Trigger). Calls: `~/hold` of the simulator.
Parameters: `trainer_node/settings.py`, hyperparameters in `trainer_node/hyperparameters.py`.

Behaviour when things go wrong: a message that cannot be used is counted and logged (throttled); a
transition with a lost part is dropped and counted; on any error or signal everything is saved and
the log says where, or that it could not be saved (seed document 4.2.2).
"""
from __future__ import annotations

from array import array
from collections import deque
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.images import image_to_array
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import read_step, VALIDATION_FIELDS
from msgs_bridge.transitions import Transition, TransitionJoiner
from msgs_bridge.twists import read_command
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger
from trainer_node.driver import Driver
from trainer_node.open_run import open_training, read_overrides, run_settings
from trainer_node.settings import TrainerSettings

# Messages of one topic that are taken before the next transition is learned from.
TAKEN_AT_ONCE = 200

# How long the learning thread sleeps when nothing has come in.
IDLE_SECONDS = 0.0005

# Times the queue limit at which transitions are dropped because nobody can be held back.
OVERRUN = 50


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
        self._joiner = TransitionJoiner()
        self._waiting: deque[Transition] = deque()
        self._failure: Exception | None = None
        self._holding = False
        self._stopping = threading.Event()
        self._weights_publisher = self.publisher(topics.WEIGHTS)
        self._inputs = (
            self.subscription(
                topics.IMAGE, self._on_image, depth=topics.STALL_DEPTH, polled=True),
            self.subscription(topics.STEP, self._on_step, polled=True),
            self.subscription(topics.CMD_VEL, self._on_twist, polled=True))
        self.subscription(topics.VALIDATION, self._on_validation)
        self.create_service(Trigger, '~/save', self._on_save)
        self.create_service(Trigger, '~/evaluate', self._on_evaluate)
        self._hold = self.create_client(SetBool, f'{settings.simulator}/hold')
        self._learner_called = self.create_guard_condition(self._on_learner)
        logger = self.get_logger()
        self._driver = Driver(
            training, self._publish_weights, say=logger.info,
            warn=lambda text: logger.warn(text, throttle_duration_sec=5.0),
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
        frame = image_to_array(message)
        self._put(self._joiner.add_image(to_nanoseconds(message.header.stamp), frame))

    def _on_step(self, message: object) -> None:
        step = read_step(read_named_values(message))
        self._put(self._joiner.add_step(to_nanoseconds(message.header.stamp), step))

    def _on_twist(self, message: object) -> None:
        command = read_command(message.twist)
        self._put(self._joiner.add_twist(to_nanoseconds(message.header.stamp), command))

    def _put(self, transitions: list[Transition]) -> None:
        room = OVERRUN * self.settings.queue_limit - len(self._waiting)
        self._waiting.extend(transitions[:room])
        if len(transitions) > room:
            # a simulator without ~/hold, or a bag played too fast
            self.counts['transitions_overrun'] += len(transitions) - room
            self.get_logger().warn(
                'transitions come faster than they are learned from and nobody answers '
                f'{self.settings.simulator}/hold: some are dropped', throttle_duration_sec=10.0)

    def _take_messages(self) -> None:
        """Take what has come in, topic by topic, and hold the simulator back or let it go on."""
        for subscription in self._inputs:
            for _ in range(TAKEN_AT_ONCE):
                if not self.take(subscription):
                    break
        if not self._holding and len(self._waiting) > self.settings.queue_limit:
            self._set_hold(True)
        elif self._holding and len(self._waiting) <= self.settings.queue_limit // 4:
            self._set_hold(False)

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
            if self._waiting:
                driver.add(self._waiting.popleft())
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
        """Return the state of learning and of the joiner."""
        values = {**self._driver.status, 'waiting': len(self._waiting), 'holding': self._holding}
        # a copy, because the learning thread may add a name
        counts = dict(self._joiner.counts)
        values.update({f'transitions_{name}': count for name, count in counts.items() if count})
        if self._failure is not None:
            return DiagnosticStatus.ERROR, f'failed: {self._failure}', values
        return DiagnosticStatus.OK, 'learning', values

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
