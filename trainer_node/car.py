# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One car in the graph: its topics, taken when it suits the learning thread, and its ~/hold."""
from __future__ import annotations

import dataclasses
import time

from dqn_policy_node.camera import Camera
from msgs_bridge import topics
from msgs_bridge.named_values import read_named_values
from msgs_bridge.node_shell import NodeShell
from msgs_bridge.stamps import to_nanoseconds
from msgs_bridge.step import CONTRACT_VERSION, read_step
from msgs_bridge.twists import read_command
from std_srvs.srv import SetBool
from trainer_node.settings import TrainerSettings
from trainer_node.source import Source

# Messages are taken topic by topic in rounds, so that no topic runs far ahead of the others.
TAKEN_AT_ONCE = 20
ROUNDS = 10

# A request may be lost with a connection, and a car goes on when it has lost who held it back.
ASK_AGAIN_SECONDS = 2.0
# how soon to look again for a ~/hold that is not there
LOOK_AGAIN_SECONDS = 0.1
# how long the publishers of a car have to be gone before it is forgotten
GONE_SECONDS = 60.0
# so many cars have deep subscriptions, more of them shallower ones
DEEP_CARS = 8


class Car:
    """
    Subscriptions of one car and what it is held back by.

    `take_messages` and `hold` belong to the learning thread, the rest to the ROS thread.

    Attributes:
        source: where what comes goes.
        holding: whether the car was asked to stand.
    """

    def __init__(
        self, node: NodeShell, source: Source, camera: Camera, settings: TrainerSettings, *,
        others: int = 0, compressed: bool = False,
    ) -> None:
        """
        Subscribe to what one car publishes.

        Args:
            node: the trainer.
            source: of the car, with its namespace for a name.
            camera: makes frames of its images.
            settings: of the trainer.
            others: how many other cars there are.
            compressed: whether its images are compressed.
        """
        self.source = source
        self.holding = False
        self._node, self._camera, self._settings = node, camera, settings
        self._foreign = ''
        # no part of them was chosen, so a size that is not the model's is worth a line
        self._whole_images = bool(source.name) and not (settings.camera_crop or compressed)
        self._ask_again_at = self._look_again_at = 0.0
        self._asked: object = None
        self._seen_at = time.monotonic()
        self._topics = {
            topic.name: dataclasses.replace(topic, name=self._below(topic.name))
            for topic in (topics.IMAGE, topics.STEP, topics.CMD_VEL, topics.EPISODE)}
        image, step, twist, episode = self._topics.values()
        depth = topics.STALL_DEPTH // (1 + others // DEEP_CARS)
        self._inputs = (
            node.subscription(
                image, self._on_image, depth=depth, polled=True,
                type_name=topics.COMPRESSED_TYPE if compressed else None),
            node.subscription(step, self._on_step, depth=depth, polled=True),
            node.subscription(twist, self._on_twist, depth=depth, polled=True))
        self._all = self._inputs
        if source.name:
            self._all = (*self._inputs, node.subscription(episode, self._on_episode))
        self._client = node.create_client(SetBool, self._below(f'{settings.simulator}/hold'))

    def _below(self, name: str) -> str:
        return f'{self.source.name}/{name}' if self.source.name else name

    # --- learning thread

    def take_messages(self) -> None:
        """Take what has come in, topic by topic."""
        for _ in range(ROUNDS):
            taken = 0
            for subscription in self._inputs:
                for _ in range(TAKEN_AT_ONCE):
                    if not subscription.take():
                        break
                    taken += 1
            if not taken:
                break
        self.source.looked()
        if self.source.name:
            self._see_that_it_is_one()

    def _see_that_it_is_one(self) -> None:
        """Refuse what comes of a foreign car, or of two at once, before it is learned from."""
        twins = [one.name for one in self._inputs[:2] if one.matched > 1]
        if twins:
            self.source.refuse(f'two publish {twins[0]}: two cars of one name, or one that was '
                               'killed and not forgotten yet')
        elif self._foreign:
            self.source.refuse(self._foreign)
        elif self.source.refused:
            self.source.accept()

    def hold(self, wanted: bool) -> None:
        """Hold the car back, or let it go on; it is asked again while it is to be held."""
        now = time.monotonic()
        asks_again = wanted and self.holding
        if not (wanted or self.holding) or now < (
                self._ask_again_at if asks_again else self._look_again_at):
            return
        if not self._node.context.ok():
            return
        if not self._client.service_is_ready():
            self._look_again_at = self._ask_again_at = now + LOOK_AGAIN_SECONDS
            return
        self._node.counts['held_back'] += wanted and not self.holding
        self.holding, self._ask_again_at = wanted, now + ASK_AGAIN_SECONDS
        if self._asked is not None and not self._asked.done():
            # who has not answered never may
            self._client.remove_pending_request(self._asked)
        self._asked = self._client.call_async(SetBool.Request(data=wanted))

    def _on_image(self, message: object) -> None:
        frame = self._camera.frame(message)
        if self._whole_images and (message.height, message.width) != frame.shape[:2]:
            # its policy scales them, too, so what is learned fits; but it may be a mistake
            self._node.warn_of(self.source.name, f'its images are {message.width}x{message.height}'
                               f', scaled to {frame.shape[1]}x{frame.shape[0]}')
        if len(message.data) > 2 * frame.nbytes:
            # a part of a large image would keep all of it in memory
            frame = frame.copy()
        self._put(self.source.add_image(to_nanoseconds(message.header.stamp), frame))

    def _on_step(self, message: object) -> None:
        step = read_step(read_named_values(message))
        self._put(self.source.add_step(to_nanoseconds(message.header.stamp), step))

    def _on_twist(self, message: object) -> None:
        command = self._settings.from_robot(read_command(message.twist))
        self._put(self.source.add_twist(to_nanoseconds(message.header.stamp), command))

    def _put(self, complete: bool) -> None:
        if not complete:
            # a simulator without ~/hold, or a bag played too fast
            self._node.warn_of(
                self.source.name or 'transitions', 'transitions come faster than they are learned '
                f'from and nobody answers {self._client.srv_name}: some are dropped')

    # --- ROS thread

    def _on_episode(self, message: object) -> None:
        version = read_named_values(message).get('contract_version', 1)
        self._foreign = '' if version == CONTRACT_VERSION else (
            f'it speaks version {version:g} of the contract, this trainer {CONTRACT_VERSION}')

    def gone(self) -> bool:
        """Return whether nobody has published anything of it for long; to be asked often."""
        now = time.monotonic()
        if any(one.publishers for one in self._inputs):
            self._seen_at = now
        return now - self._seen_at > GONE_SECONDS

    def silence(self) -> str:
        """Return why nothing can be joined, '' if something is."""
        topic = self.source.silent_topic
        if not topic:
            return ''
        found = dict(zip(
            (topics.IMAGE.name, topics.STEP.name, topics.CMD_VEL.name), self._inputs))[topic]
        if not found.publishers:
            return f'no {topic}: nobody publishes {found.name}'
        if len(found.unheard) == found.publishers:
            return f'no {topic}: nothing that is published on {found.name} fits'
        if (self._node.counts[f'rejected_{self._topics[topic].name}']
                and not self.source.joiner.counts['joined']):
            return f'no {topic} that can be used'
        waiting = self.source.joiner.waiting
        if waiting:
            return f'no {topic} with the stamp of the oldest of {waiting} steps that wait for it'
        return f'no {topic} at the moment'

    def problem(self) -> str:
        """Return what is wrong with it, '' if all is well."""
        return self.source.refused or self.silence() or self.source.losses()

    def forget(self) -> None:
        """Hear nothing more of it."""
        for subscription in self._all:
            self._node.unsubscribe(subscription)
        self._node.destroy_client(self._client)
