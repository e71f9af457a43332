# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Publishes a bag as any number of cars, again and again, about as fast as the trainer takes it.

`python -m carracing_dqn.benchmarks.car_feeder_node --bag BAG --cars 8 --namespace /bench`

Each car has its place in the bag and its ~/hold, so that what is measured is what the trainer
takes in and not what it drops. The pace rises until the trainer holds the cars back, and falls a
little with each time it does: a flood would only be lost on the way. A loop rewinds time, as when
a bag is played with `--loop`.
"""
from __future__ import annotations

import argparse
import contextlib
import itertools
from pathlib import Path
import sys
import threading
import time

from bags.reader import BagReader
from bags.topic_lookup import need_topic
from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.message_types import message_class
from msgs_bridge.qos import qos_profile
from msgs_bridge.topics import CMD_VEL, IMAGE, STEP
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_srvs.srv import SetBool

HOLDER = 'carracing_sim_node'
IDLE_SECONDS = 0.0005


class Pace:
    """How many transitions a second go out: more and more, and a little less after each hold."""

    FIRST, RISE, FALL = 100.0, 1.05, 0.95
    RISE_SECONDS = 0.05

    def __init__(self) -> None:
        """Start slowly."""
        self._rate = self.FIRST
        self._owed, self._last = 0.0, time.monotonic()
        self._rises_at = self._last
        self._held = False

    def due(self, held: bool) -> int:
        """Return how many transitions may go out now; `held` says whether any car is held."""
        now = time.monotonic()
        elapsed, self._last = now - self._last, now
        if held and not self._held:
            self._rate *= self.FALL
        elif not held and now > self._rises_at:
            self._rate *= self.RISE
            self._rises_at = now + self.RISE_SECONDS
        self._held = held
        # what could not go out for a while is not made up for
        self._owed = 0.0 if held else min(self._owed + elapsed * self._rate, self._rate / 20 + 1)
        count = int(self._owed)
        self._owed -= count
        return count


class Feed:
    """One car: where it is in the bag, and whether it is held back."""

    def __init__(self, node: rclpy.node.Node, space: str) -> None:
        """Offer ~/hold and wait for the trainer."""
        self.held, self.place = False, 0
        self.publishers = [
            node.create_publisher(message_class(topic.type_name), f'{space}/{topic.name}',
                                  qos_profile(topic)) for topic in (IMAGE, STEP, CMD_VEL)]
        node.create_service(SetBool, f'{space}/{HOLDER}/hold', self._hold)

    def _hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.held, response.success = request.data, True
        return response

    @property
    def heard(self) -> bool:
        """Return whether everything it publishes has a subscription."""
        return all(one.get_subscription_count() for one in self.publishers)


def read_messages(bag: Path) -> list[tuple[int, bytes]]:
    """Return the messages of a bag in order, each with 0 for an image, 1 a step, 2 a twist."""
    with BagReader(bag) as reader:
        names = [need_topic(reader, topic) for topic in (IMAGE, STEP, CMD_VEL)]
        return [(names.index(message.topic), bytes(message.data))
                for message in reader.messages(names)]


def feed(feeds: list[Feed], messages: list[tuple[int, bytes]]) -> None:
    """Let the cars publish up to their next step, by turns, for ever."""
    pace, turns = Pace(), itertools.cycle(feeds)
    while rclpy.ok():
        due = pace.due(any(one.held for one in feeds))
        for one in itertools.islice(turns, due):
            kind = 0
            while kind != 1:
                kind, data = messages[one.place]
                one.publishers[kind].publish(data)
                one.place = (one.place + 1) % len(messages)
        if not due:
            time.sleep(IDLE_SECONDS)


def main(words: list[str] | None = None) -> int:
    """Feed until a signal comes; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--bag', type=Path, required=True)
    parser.add_argument('--cars', type=int, required=True)
    parser.add_argument('--namespace', default='')
    arguments = parser.parse_args(words)
    messages = read_messages(arguments.bag)
    before_rclpy()
    rclpy.init()
    node = rclpy.create_node('car_feeder', enable_rosout=False, start_parameter_services=False)
    feeds = [Feed(node, f'{arguments.namespace}/car_{car}') for car in range(arguments.cars)]
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def listen() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    threading.Thread(target=listen, daemon=True).start()
    try:
        while not all(one.heard for one in feeds):
            time.sleep(0.1)
        feed(feeds, messages)
    except KeyboardInterrupt:
        pass
    rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
