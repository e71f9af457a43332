# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The player: publishes a bag again, at the recorded pace or another."""
from __future__ import annotations

import sys
import threading
import time
from typing import Any

from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from bags.errors import BagError
from bags.live_qos import offer_for
from bags.playback import Playback
from bags.read_ahead import ReadAhead
from bags.messages import BagMessage
from bags.reader import BagReader
from bags.settings import ALL, names_of, PlayerSettings
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.stamps import set_stamp
from msgs_bridge.topics import CLOCK, TOPICS
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy

# what the subscribers have at the end to take the last messages
LAST_WORDS = Duration(seconds=1)
# A reliable subscription that is slower for a while loses nothing.
DEPTH = 1000
LOOK_SECONDS = 0.02
SWITCH_SECONDS = 0.0002
# messages that the diagnostics judge the timing by
RECENT = 1000


class BagPlayerNode(NodeShell):
    """
    Play a bag.

    Purpose: publish what was recorded, the same bytes in the same order, by log time.

    Publishes: the topics of the bag, with the QoS they were recorded with; `/clock` if
    `clock_rate` is set (a recorded `/clock` is left out then); `/diagnostics`.

    Services: `~/pause` (std_srvs/SetBool), `~/step` (std_srvs/Trigger): one message while paused;
    `~/hold` (std_srvs/SetBool): a slow learner holds the bag back.

    Parameters: `bags.settings.PlayerSettings`; `rate` can be changed while playing.

    Behaviour when things go wrong: a bag that cannot be read ends the node with one line and
    code 2; a topic whose type is not installed is left out with a warning.
    """

    def __init__(self) -> None:
        """
        Open the bag and start to play.

        Raises:
            BagError: a bag that cannot be read, or a topic that it does not have.
        """
        super().__init__('bag_player_node', PlayerSettings)
        settings = self.settings
        if not settings.bag:
            raise BagError('no bag was given; set the parameter `bag`')
        self._reader = BagReader(settings.bag)
        self._remaps = parse_remaps(settings.remaps)
        self._outputs: dict[str, Any] = {}
        self._create_publishers(self._chosen_topics())
        self._clock_message = Clock()
        clock = self.publisher(CLOCK) if settings.clock_rate > 0 else None
        self._clock_publisher = clock
        self._playback = Playback(
            self._publish, rate=settings.rate, paused=settings.start_paused,
            publish_clock=self._publish_clock, clock_rate=settings.clock_rate)
        self._error: BaseException | None = None
        self._done = threading.Event()
        self._closed = False
        self._ahead: ReadAhead | None = None
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.serve_hold(lambda: self._playback.hold(self.held_back))
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_timer(LOOK_SECONDS, self._look)
        self.get_logger().info(
            f'playing {settings.bag}: {", ".join(sorted(self._outputs)) or "no topics"}')
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._play, name='bag_player', daemon=True)
        self._thread.start()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return how far it is and how late."""
        level, _, values = super().health()
        middle, worst, _ = self._playback.timing_error(RECENT)
        return level, 'playing', {
            **values, 'played': self._playback.played,
            'timing_error_p50_ms': 1e3 * middle, 'timing_error_p99_ms': 1e3 * worst}

    def settings_changed(self) -> None:
        """Take over another rate."""
        self._playback.set_rate(self.settings.rate)

    def close(self) -> None:
        """Stop, and say how it went."""
        if self._closed:
            return
        self._closed = True
        self._playback.stop()
        self._done.set()
        self._thread.join()
        seconds = time.monotonic() - self._began
        middle, worst, most = (1e3 * value for value in self._playback.timing_error())
        sys.stderr.write(
            f'{self._playback.played} messages played in {seconds:.2f} s; timing error p50 '
            f'{middle:.3f} ms, p99 {worst:.3f} ms, max {most:.3f} ms\n')
        self._reader.close()

    def _chosen_topics(self) -> list[str]:
        settings = self.settings
        if settings.topics.strip() == ALL:
            chosen = list(self._reader.topics)
        else:
            chosen = [self.resolve_topic_name(name) for name in names_of(settings.topics)]
            for name in chosen:
                if name not in self._reader.topics:
                    accepted = ', '.join(sorted(self._reader.topics))
                    raise BagError(f'{settings.bag} has no topic {name!r}; it has {accepted}')
        if settings.clock_rate > 0 and CLOCK.name in chosen:
            chosen.remove(CLOCK.name)
        return chosen

    def _create_publishers(self, chosen: list[str]) -> None:
        depths = {topic.name.lstrip('/'): topic.depth for topic in TOPICS if topic.latched}
        for name in chosen:
            topic = self._reader.topics[name]
            try:
                kind = message_class(topic.type_name)
            except (ImportError, AttributeError, ValueError):
                self.counts['topics_not_played'] += 1
                self.get_logger().warn(
                    f'{name} is not played: its type {topic.type_name} is not installed here')
                continue
            profile, agreed = offer_for(topic.qos)
            if not agreed and topic.qos:
                self.get_logger().warn(f'{name} was published with several QoS profiles')
            if profile.durability == DurabilityPolicy.VOLATILE:
                profile.depth = DEPTH
            else:
                # late subscribers get as many as the node that published it would have kept
                profile.depth = depths.get(name.rpartition('/')[2], profile.depth)
            target = self._remaps.get(name, name)
            self._outputs[name] = self.create_publisher(kind, target, profile)

    def _play(self) -> None:
        try:
            self._wait_for_subscribers()
            settings = self.settings
            start = self._reader.start_time + round(settings.start_offset * 1e9)
            stop = start + round(settings.duration * 1e9) if settings.duration > 0 else None
            while not self._done.is_set():
                self._ahead = ReadAhead(
                    self._reader.messages(list(self._outputs), start, stop))
                try:
                    self._playback.now = start
                    self._playback.play(self._ahead)
                finally:
                    self._ahead.close()
                if not settings.loop or not self._outputs:
                    break
            for publisher in self._outputs.values():
                if not self._done.is_set():
                    publisher.wait_for_all_acked(LAST_WORDS)
        except BaseException as error:
            # raised again where the executor sees it
            self._error = error
        finally:
            self._done.set()

    def _wait_for_subscribers(self) -> None:
        deadline = time.monotonic() + self.settings.wait_for_subscribers
        while time.monotonic() < deadline and not self._done.is_set():
            if all(one.get_subscription_count() for one in self._outputs.values()):
                return
            time.sleep(0.01)

    def _look(self) -> None:
        """End the node when everything has been played."""
        if self._done.is_set():
            if self._error is not None:
                raise self._error
            raise Finished

    def _publish(self, message: BagMessage) -> None:
        self._outputs[message.topic].publish(bytes(message.data))

    def _publish_clock(self, bag_time: int) -> None:
        if self._clock_publisher is not None:
            set_stamp(self._clock_message.clock, bag_time)
            self._clock_publisher.publish(self._clock_message)

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._playback.pause(request.data)
        response.success = True
        response.message = 'paused' if request.data else 'playing'
        return response

    def _on_step(self, request: Any, response: Any) -> Any:
        response.success = self._playback.step()
        response.message = 'one message' if response.success else 'not paused'
        return response


def parse_remaps(text: str) -> dict[str, str]:
    """
    Return from -> to of `from:=to` pairs, separated by commas; names without / get one.

    Raises:
        BagError: a pair that is not one.
    """
    remaps = {}
    for pair in names_of(text):
        source, separator, target = pair.partition(':=')
        if not separator or not source or not target:
            raise BagError(f'remap {pair!r} is not of the form from:=to')
        remaps[source if source.startswith('/') else f'/{source}'] = target
    return remaps


def main(args: list[str] | None = None) -> int:
    """Run the player."""
    # the thread that reads ahead must not keep a message that is due waiting for Python's 5 ms
    sys.setswitchinterval(SWITCH_SECONDS)
    return run_node(BagPlayerNode, args)


if __name__ == '__main__':
    sys.exit(main())
