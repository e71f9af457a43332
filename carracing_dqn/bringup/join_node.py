# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A node that looks for a trainer of several cars, and for the cars that it has."""
from __future__ import annotations

import contextlib
import dataclasses
import time
from typing import Any

from carracing_dqn.bringup.graph import CAR, car_space
from dqn_policy_node.weights_message import read_extra
from msgs_bridge import topics
from msgs_bridge.errors import BridgeError
from msgs_bridge.listening_node import node_of_a_command
from msgs_bridge.message_types import message_class
from msgs_bridge.plain_text import plain
from msgs_bridge.qos import qos_profile
from msgs_bridge.seeds import MAX_CARS
import rclpy

# cars make themselves known within so long after the trainer was found
SETTLE_SECONDS = 2.0
TURN_SECONDS = 0.2
MOST_EPISODES = 10**9
# of what the trainer's simulator is set to, what another host may be told: numbers, no names of
# code to run
NUMBERS = {'action_repeat': 50, 'early_end_frames': 100_000}
SWITCHES = ('early_end_lap',)


@dataclasses.dataclass(frozen=True)
class Handout:
    """
    What a trainer tells cars that join, all of it checked.

    Attributes:
        seed: of the run.
        simulator: name of the simulator, to be compared and not to be run.
        parameters: of the simulator node.
        episodes: how many each source has behind it, by name.
        cars: how many there are to be.
        spread: of epsilon over them.
        taken: numbers of the cars that drive already.
    """

    seed: int
    simulator: str
    parameters: dict[str, int | bool]
    episodes: dict[str, int]
    cars: int
    spread: float
    taken: frozenset[int] = frozenset()


def find_trainer(namespace: str, seconds: float) -> Handout:
    """
    Wait for the weights of a trainer, and look which cars there are.

    Args:
        namespace: absolute, of the trainer; '' for the root.
        seconds: how long to wait at most.

    Raises:
        BridgeError: none came, or what came is not of a trainer of several cars.
    """
    node, executor = node_of_a_command('carracing_join', namespace)
    try:
        heard: list[Handout | BridgeError] = []

        def take(message: Any) -> None:
            with contextlib.suppress(IndexError):
                heard.pop()
            try:
                heard.append(read_handout(bytes(message.data)))
            except BridgeError as error:
                heard.append(error)

        node.create_subscription(
            message_class(topics.WEIGHTS.type_name), topics.WEIGHTS.name, take,
            qos_profile(topics.WEIGHTS))
        deadline = time.monotonic() + seconds
        while not heard:
            if time.monotonic() > deadline:
                raise BridgeError(
                    f'no trainer publishes {namespace}/{topics.WEIGHTS.name} ({seconds:g} s '
                    'waited); start carracing train --role learner; on another host '
                    'ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS matter on both, see '
                    'docs/scaling.md')
            executor.spin_once(timeout_sec=TURN_SECONDS)
        settled = time.monotonic() + SETTLE_SECONDS
        while time.monotonic() < settled:
            executor.spin_once(timeout_sec=TURN_SECONDS)
        if isinstance(heard[0], BridgeError):
            raise heard[0]
        return dataclasses.replace(heard[0], taken=frozenset(
            car for car in range(MAX_CARS)
            if node.count_publishers(f'{namespace}/{car_space(car)}/{topics.STEP.name}')))
    finally:
        rclpy.try_shutdown(context=node.context)


def read_handout(data: bytes) -> Handout:
    """
    Return what a weights message says to cars that join.

    Raises:
        BridgeError: it is no weights message, not of a trainer of several cars, or a value is
            not what it should be.
    """
    extra = read_extra(data)
    if 'simulator' not in extra:
        raise BridgeError('that trainer learns from one car alone; one that takes in others is '
                          'started with carracing train --role learner')
    simulator, episodes = extra.get('simulator'), extra.get('episodes')
    if not isinstance(simulator, dict) or not isinstance(episodes, dict):
        raise BridgeError('the trainer says nothing that can be used of how to join')
    parameters: dict[str, int | bool] = {
        name: _number(simulator[name], name, most) for name, most in NUMBERS.items()
        if name in simulator}
    parameters.update({name: simulator[name] is True for name in SWITCHES if name in simulator})
    return Handout(
        _number(extra.get('seed'), 'seed', 2**31 - 1), plain(simulator.get('simulator', ''), 300),
        parameters,
        {str(name): _number(count, 'episodes', MOST_EPISODES)
         for name, count in list(episodes.items())[:MAX_CARS]},
        _number(extra.get('cars'), 'cars', MAX_CARS),
        _number(extra.get('spread'), 'spread', 100))


def free_car(taken: frozenset[int]) -> int:
    """Return the lowest number that no car has; raises BridgeError if there is none."""
    for car in range(MAX_CARS):
        if car not in taken:
            return car
    raise BridgeError(f'there are {MAX_CARS} cars ({CAR}0 to {CAR}{MAX_CARS - 1}) already')


def _number(value: Any, name: str, most: int) -> Any:
    if type(value) not in (int, float) or not 0 <= value <= most or (
            name != 'spread' and type(value) is not int):
        raise BridgeError(f'the trainer says that {name} is {plain(value)}; accepted: 0 to {most}')
    return value
