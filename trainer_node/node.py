# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
trainer_node: transitions in, better weights out.

Purpose: join `image_raw`, `step` and `cmd_vel` into transitions, learn from them, publish weights.
Images and twists go through the same camera and scale as those of the policy.

Subscribes: `image_raw`, `step`, `cmd_vel`, `validation`; with `sources` the first three and
`episode` of every car that they mean, as it appears. Publishes: `weights`, `/diagnostics`.
Services: `~/save`, `~/evaluate` (std_srvs/Trigger). Calls: `~/hold` of the simulators, if they
have that.
Parameters: `trainer_node/settings.py`, hyperparameters in `trainer_node/hyperparameters.py`.

Behaviour when things go wrong: a message that cannot be used is counted and logged (throttled); a
transition with a lost part is dropped and counted; when nothing can be joined, the diagnostics
name the topic that is to blame. On any signal everything is saved and what waits is dropped; a
loss that is not finite, or a step that lacks what a shaping term needs, ends learning, and the
checkpoint of before is kept. The log says where, or that it could not be saved (seed document
4.2.2). Of several cars, one that cannot be learned from is named and left out.
"""
from __future__ import annotations

from array import array
from collections.abc import Iterator
import dataclasses
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from dqn_policy_node.camera import Camera
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.last_line import say
from msgs_bridge.matching import as_known, topics_of
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.step import VALIDATION_FIELDS
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import Trigger
from trainer_node.car import Car
from trainer_node.driver import Driver
from trainer_node.open_run import open_training, read_overrides, run_settings
from trainer_node.settings import LEARNING, PRETRAINING, TrainerSettings, VALIDATING
from trainer_node.sources import MOST, SourceNames, Sources

# how often cars are looked for in the graph
LOOK_SECONDS = 1.0
# what tells a car in the graph
CAR_SUFFIX = f'/{topics.STEP.name}'

# How long the learning thread sleeps when nothing has come in; looking at many cars takes longer.
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
        self._names = SourceNames(settings.sources, self.get_namespace())
        training = open_training(
            settings.run, run_settings(
                settings.run, settings.preset,
                read_overrides(filter(None, settings.overrides.split(','))),
                resume=settings.resume),
            resume=settings.resume, device=settings.device, tensorboard=settings.tensorboard)
        preprocessing = training.description.preprocessing
        self._cameras = {compressed: Camera(
            dataclasses.replace(settings, camera_compressed=compressed),
            preprocessing.frame_height, preprocessing.frame_width) for compressed in (False, True)}
        self._sources = Sources(settings.queue_limit)
        self._cars: tuple[Car, ...] = ()
        self._problems: dict[str, str] = {}
        self._failure: Exception | None = None
        self._holding = False
        self._said_of_pace = ''
        self._stopping = threading.Event()
        self._weights_publisher = self.publisher(topics.WEIGHTS)
        if self._names:
            training.several, training.cars = True, settings.cars
            for name in self._names.given:
                self._add_car(name)
            self.create_timer(LOOK_SECONDS, self._look_for_cars)
        else:
            self._add_car('')
        self.subscription(topics.VALIDATION, self._on_validation)
        self.create_service(Trigger, '~/save', self._on_save)
        self.create_service(Trigger, '~/evaluate', self._on_evaluate)
        self._learner_called = self.create_guard_condition(self._on_learner)
        self._driver = Driver(
            training, self._publish_weights, say=self.get_logger().info,
            warn=self.warn_of,
            last_validation_seconds=settings.last_validation_seconds)
        self._learning = threading.Thread(target=self._learn, name='learning')
        self._learning.start()
        self.get_logger().info(f'learning into {settings.run}')

    # --- ROS thread

    def _add_car(self, name: str, *, compressed: bool | None = None) -> None:
        """Take in a car; `compressed` says of its images what differs from the parameter."""
        if compressed is None:
            compressed = self.settings.camera_compressed
        self._cars = (*self._cars, Car(
            self, self._sources.add(name), self._cameras[compressed], self.settings,
            others=len(self._cars), compressed=compressed))

    def _look_for_cars(self) -> None:
        """Take in cars that have appeared, and forget those that are gone for long."""
        for car in [car for car in self._cars
                    if car.source.name not in self._names.given and car.gone()]:
            self._cars = tuple(one for one in self._cars if one is not car)
            self._sources.remove(car.source)
            car.forget()
            self.get_logger().info(f'{car.source.name} is gone')
        known = {car.source.name for car in self._cars}
        there = as_known(topics_of, self)
        found = self._names.matching(
            name.removesuffix(CAR_SUFFIX) for name in there if name.endswith(CAR_SUFFIX))
        for name in found:
            if name in known or not self.count_publishers(f'{name}{CAR_SUFFIX}'):
                continue
            if len(self._cars) >= MOST:
                self.warn_of('sources', f'{name} is left out: there are {MOST} cars')
                break
            images = there.get(f'{name}/{topics.IMAGE.name}', ())
            # one car may compress and another not
            self._add_car(name, compressed=topics.COMPRESSED_TYPE in images
                          and topics.IMAGE.type_name not in images or None)
            self.get_logger().info(f'{name} has come')

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

    # --- learning thread

    def _take_messages(self) -> None:
        """Take what has come in from every car, and hold all back or let them go on."""
        for car in self._cars:
            car.take_messages()
        self._holding = self._sources.should_hold(self._holding)
        for car in self._cars:
            if self._holding or car.holding:
                car.hold(self._holding)

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
            # looking for messages of many cars takes time, so it is done once for all of them
            for _ in range(max(len(self._cars), 1)):
                taken = None if driver.pretraining else self._sources.take()
                if taken is not None:
                    driver.add(*taken)
                if not driver.turn():
                    return
                if taken is None and not driver.pretraining:
                    time.sleep(IDLE_SECONDS * max(len(self._cars) / 2, 1))
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
        """Return the state of learning and of its sources, or why nothing is learned."""
        self._problems = {car.source.name: car.problem() for car in self._cars
                          if car.source.name and not self._driver.ended}
        values = {**self._driver.status, **self._source_figures(), 'holding': self._holding}
        if self._failure is not None:
            return DiagnosticStatus.ERROR, f'failed: {self._failure}', values
        problem = self._problem() or self._pace()
        if problem:
            return DiagnosticStatus.WARN, problem, values
        doing = (VALIDATING if self._driver.ended
                 else PRETRAINING if self._driver.pretraining else LEARNING)
        return DiagnosticStatus.OK, doing, values

    def _pace(self) -> str:
        """Return that the run ends too soon, '' if it does not; the log has it once."""
        warning = self._driver.outlook.warning
        if warning and not self._said_of_pace:
            self.get_logger().warn(warning)
        self._said_of_pace = self._said_of_pace or warning
        return warning

    def _source_figures(self) -> dict[str, object]:
        if not self._names:
            return self._cars[0].source.figures()
        return {'cars': len(self._cars), 'waiting': sum(len(car.source) for car in self._cars)}

    def _problem(self) -> str:
        """Return why nothing is learned, or what is not; '' if all is well."""
        if self.count_publishers(self._weights_publisher.topic_name) > 1:
            return f'another trainer publishes {self._weights_publisher.topic_name}, too'
        if not self._names:
            car = self._cars[0]
            return (not self._driver.ended and car.silence()) or car.source.losses()
        if not self._cars:
            return f'no car: nobody publishes step below {self.settings.sources}'
        odd = sorted(
            car.source.name for car in self._cars if self._problems.get(car.source.name))
        first = f'{odd[0]}: {self._problems[odd[0]]}' if odd else ''
        return f'{first} (and {len(odd) - 1} more cars)' if len(odd) > 1 else first

    def parts_health(self) -> Iterator[tuple[str, bytes, str, dict[str, object]]]:
        """Yield the health of each car that has a name."""
        remembered = dict(self._driver.training.learning.sources)
        for car in self._cars:
            source = car.source
            if not source.name:
                continue
            problem = self._problems.get(source.name, '')
            values = {'transitions_per_second': source.rate(), 'lag': source.lag,
                      'silent_seconds': source.silent_seconds, 'lost': source.lost,
                      'holding': car.holding, **source.figures()}
            of = remembered.get(source.name)
            if of is not None:
                values.update(episodes=of.episodes, decisions=of.decisions, **dict(of.left_out))
                if of.last_return is not None:
                    values['last_return'] = of.last_return
            yield (source.name, DiagnosticStatus.WARN if problem else DiagnosticStatus.OK,
                   problem or 'learned from', values)

    def close(self) -> None:
        """Finish the update under way, then save everything or say that it could not be."""
        self._stopping.set()
        self._learning.join()
        training = self._driver.training
        if training.failed:
            say(f'kept {training.folder.checkpoint}, of before learning failed')
            return
        try:
            say(f'saved {self._driver.close()}')
        except BridgeError as error:
            say(f'error: the run could NOT be saved: {error}')


def main(args: list[str] | None = None) -> int:
    """Run the node until it is stopped or the run is complete."""
    return run_node(TrainerNode, args)


if __name__ == '__main__':
    sys.exit(main())
