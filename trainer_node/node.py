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
import queue
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError, MessageError
from msgs_bridge.images import image_to_array
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import read_step, VALIDATION_FIELDS
from msgs_bridge.transitions import Transition, TransitionJoiner
from msgs_bridge.twists import read_command
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger
from trainer_node.open_run import read_overrides, run_settings
from trainer_node.settings import TrainerSettings
from trainer_node.training import Training

# A snapshot for the diagnostics is taken by the learning thread, every so many transitions.
STATUS_EVERY = 20

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
        self._training = self._open()
        self._joiner = TransitionJoiner()
        self._requests: queue.SimpleQueue[object] = queue.SimpleQueue()
        self._waiting: deque[Transition] = deque()
        self._status = self._training.status()
        self._failure: Exception | None = None
        self._complete = False
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
        self._publish_weights()
        self._learning = threading.Thread(target=self._learn, name='learning')
        self._learning.start()
        self.get_logger().info(f'learning into {settings.run}')

    def _open(self) -> Training:
        settings = self.settings
        overrides = read_overrides(filter(None, settings.overrides.split(',')))
        hyperparameters = run_settings(
            settings.run, settings.preset, overrides, resume=settings.resume)
        options = {'device': settings.device, 'tensorboard': settings.tensorboard}
        if settings.resume:
            return Training.resume(settings.run, hyperparameters, **options)
        return Training.create(hyperparameters, settings.run, **options)

    # --- ROS thread

    def _on_validation(self, message: object) -> None:
        self._requests.put(read_named_values(message, VALIDATION_FIELDS))

    def _on_learner(self) -> None:
        """Answer the learning thread, which is complete or has failed."""
        if self._failure is not None:
            raise BridgeError(f'learning stopped: {self._failure}') from self._failure
        if self._complete:
            raise Finished

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._requests.put('save')
        response.success = True
        response.message = f'saving into {self.settings.run}'
        return response

    def _on_evaluate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._requests.put('validate')
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
        training = self._training
        # version whose validation is waited for at the end of the run, and until when
        last_version, give_up_at = None, 0.0
        while self._waiting or not self._stopping.is_set():
            if not self._stopping.is_set():
                self._take_messages()
            if self._waiting:
                self._add(self._waiting.popleft(), learning=last_version is None)
            else:
                time.sleep(IDLE_SECONDS)
            request = None if self._requests.empty() else self._requests.get()
            if isinstance(request, dict):
                self._take_validation(request)
                if last_version is not None and request['version'] >= last_version:
                    break
            if request == 'save' or training.checkpoint_due():
                self.get_logger().info(f'saved {training.save()}')
            if request == 'validate' or training.weights_due():
                self._publish_weights(validate=True if request == 'validate' else None)
            if last_version is not None:
                if time.monotonic() > give_up_at:
                    self.get_logger().warn('no validation of the last weights came in time')
                    break
            elif training.complete:
                if not self.settings.last_validation_seconds or self._stopping.is_set():
                    break
                last_version = self._publish_weights(validate=True)
                give_up_at = time.monotonic() + self.settings.last_validation_seconds
        self._complete = training.complete

    def _add(self, transition: Transition, *, learning: bool) -> None:
        """Learn from a transition; at the end of the run only the validation is waited for."""
        if not learning:
            return
        try:
            self._training.add(transition)
        except MessageError as error:
            self.get_logger().warn(f'left out: {error}', throttle_duration_sec=5.0)
        if self._training.decisions % STATUS_EVERY == 0:
            self._status = self._training.status()

    def _take_validation(self, values: dict[str, float]) -> None:
        try:
            better = self._training.record_validation(values)
        except MessageError as error:
            self.get_logger().warn(f'left out: {error}')
            return
        if better:
            self.get_logger().info(
                f'version {values["version"]:.0f} is the best so far: {values["mean"]:.1f}')

    def _publish_weights(self, *, validate: bool | None = None) -> int:
        """Send the acting weights; return their version."""
        data = self._training.weights_message(validate=validate)
        if self.context.ok():
            message = UInt8MultiArray()
            # array('B') is copied at once; a list would be copied byte by byte
            message.data = array('B', data)
            self._weights_publisher.publish(message)
        return self._training.version

    # --- both

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return the state of learning and of the joiner."""
        values = {**self._status, 'waiting': len(self._waiting), 'holding': self._holding}
        values.update({f'transitions_{name}': n for name, n in self._joiner.counts.items() if n})
        if self._failure is not None:
            return DiagnosticStatus.ERROR, f'failed: {self._failure}', values
        return DiagnosticStatus.OK, 'learning', values

    def close(self) -> None:
        """Finish the update under way, then save everything or say that it could not be."""
        self._stopping.set()
        self._learning.join()
        try:
            saved = self._training.finish() if self._complete else self._training.save()
            sys.stderr.write(f'saved {saved}\n')
        except (OSError, BridgeError) as error:
            sys.stderr.write(f'error: the run could NOT be saved: {error}\n')


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped or the run is complete."""
    return run_node(TrainerNode, args)


if __name__ == '__main__':
    sys.exit(main())
