# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
validation_node: greedy laps with the weights that the trainer publishes.

Purpose: drive greedy laps on the validation tracks, in this process, with every version of the
weights that the trainer marks for validation.

Subscribes: `weights`. Publishes: `validation`, `/diagnostics`.
Parameters: `carracing_dqn/evaluation/settings.py`.

Behaviour when things go wrong: weights whose hash, description or values are wrong are counted
and logged (throttled), and so is a validation that cannot be driven; while laps are driven, newer
versions wait and only the newest is driven.
"""
from __future__ import annotations

from concurrent.futures import Future
import contextlib
import queue
import sys
import threading

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
from msgs_bridge.plain_text import plain
from msgs_bridge.simulator import Simulator
from msgs_bridge.stamps import to_nanoseconds
from sensor_msgs.msg import JointState


class ValidationNode(NodeShell):
    """
    The validator as a node.

    A thread of its own drives the laps, so that services, parameters and diagnostics answer
    meanwhile. It hands results and failures to the ROS thread.
    """

    def __init__(self) -> None:
        """Declare parameters and wait for marked weights."""
        super().__init__('validation_node', ValidationSettings)
        # with the simulator, or why there is none
        self._made: Future[Simulator] = Future()
        self._wanted: queue.Queue[WeightsUpdate] = queue.Queue(maxsize=1)
        self._results: queue.SimpleQueue[dict[str, float] | Exception] = queue.SimpleQueue()
        self._driven = -1
        self._stopping = threading.Event()
        self._validation = self.publisher(topics.VALIDATION)
        self.subscription(topics.WEIGHTS, self._on_weights)
        self._lap_driver_called = self.create_guard_condition(self._on_result)
        # it is left alone at the end, because a lap may take longer than a node has to stop
        threading.Thread(target=self._drive, name='laps', daemon=True).start()
        self._made.result()

    def _on_weights(self, message: object) -> None:
        try:
            data = bytes(message.data)
            update = decode_weights(data) if is_marked(data) else None
        except BridgeError as error:
            raise MessageError(str(error)) from None
        if update is None or update.version == self._driven:
            return
        # one that still waits is older
        with contextlib.suppress(queue.Empty):
            self._wanted.get_nowait()
        self._wanted.put(update)

    def _drive(self) -> None:
        """Drive the laps of the newest marked version, again and again."""
        try:
            # in this thread, to which a simulator that draws by OpenGL is bound
            self._made.set_result(make_simulator(self.settings.simulator))
        except BaseException as error:
            self._made.set_exception(error)
            return
        while not self._stopping.is_set():
            update = self._wanted.get()
            self._driven = update.version
            try:
                result: dict[str, float] | Exception = self._validate(update)
            except Exception as error:  # the ROS thread must see every kind
                result = error
            if not self._stopping.is_set():
                self._results.put(result)
                self._lap_driver_called.trigger()

    def _validate(self, update: WeightsUpdate) -> dict[str, float]:
        simulator = self._made.result()
        policy = Policy(update.description, frame_seconds=simulator.frame_seconds)
        policy.swap_weights(update)
        policy.act_greedily()
        seeds = range(self.settings.seed, self.settings.seed + self.settings.tracks)
        return validate(policy, seeds, version=update.version, simulator=simulator,
                        should_stop=self._stopping.is_set)

    def _on_result(self) -> None:
        """Publish what the thread has driven; raise what it has raised."""
        while not self._results.empty():
            result = self._results.get()
            # a machine that lacks something for a while, such as descriptors, has it again later
            if isinstance(result, (BridgeError, OSError)):
                self.counts['failed_validations'] += 1
                self.get_logger().warn(f'no validation: {plain(result)}')
                continue
            if isinstance(result, Exception):
                raise result
            now = to_nanoseconds(self.get_clock().now().to_msg())
            self._validation.publish(fill_named_values(JointState(), result, now))
            self.counts['validations'] += 1
            self.get_logger().info(
                f'version {result["version"]}: mean {result["mean"]:.1f}, '
                f'{result["completed"]:.0%} completed, {result["seconds"]:.1f} s')

    def close(self) -> None:
        """Drive no further lap."""
        self._stopping.set()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return the version that was driven last."""
        return DiagnosticStatus.OK, 'validating', {'version': self._driven}


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped."""
    return run_node(ValidationNode, args)


if __name__ == '__main__':
    sys.exit(main())
