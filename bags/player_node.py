# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The player: publishes a bag again, at the recorded pace or another."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import contextlib
import functools
from itertools import islice
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from bags.decode import decode_bundle
from bags.errors import BagError
from bags.listeners import Listeners
from bags.live_qos import offer_for
from bags.lockstep import Answers, Comparison
from bags.mcap_file import ENCODING
from bags.messages import BagMessage
from bags.playback import Playback
from bags.player_terminal import PlayerTerminal
from bags.read_ahead import ReadAhead
from bags.reader import BagReader
from bags.settings import ALL, chosen_names, names_of, PlayerSettings
from msgs_bridge.errors import BridgeError
from msgs_bridge.last_line import say
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import Finished, NodeShell, run_node
from msgs_bridge.plain_text import plain
from msgs_bridge.stamps import NANOSECONDS, set_stamp
from msgs_bridge.topics import CLOCK, CMD_VEL, IMAGE, Q_VALUES, TOPICS
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

# seconds that the subscribers have at the end to take the last messages
LAST_WORDS = 2.0
# A reliable subscription that is slower for a while loses nothing: so many messages of a topic
# wait for it, but no more than so many bytes by the size of its first messages.
DEPTH, LEAST_DEPTH = 1000, 4
DEPTH_BYTES = 64 << 20
FIRST_MESSAGES = 500
# Played as fast as possible, a topic waits for its subscribers each time that half of its
# history is new, but not for long: one of them may have stopped.
CONFIRM_PART, CONFIRM_SECONDS = 2, Duration(seconds=1)
LOOK_SECONDS = 0.02
# Q-values of who drives that may wait to be compared
COMPARED_DEPTH = 500
# of a longer silence than so many seconds it is said that it comes
GAP_SECONDS = 60.0
# how often it is looked who listens
LISTENERS_SECONDS = 0.5
# what DDS may need to find a subscription once its publisher was found
MUTUAL_SECONDS = 0.5
SWITCH_SECONDS = 0.0002
# the first time in ns that a message of a clock, which counts seconds in 32 bits, cannot say
CLOCK_END = 2 ** 31 * NANOSECONDS
# messages that the diagnostics judge the timing by
RECENT = 1000
# more topics than this no graph has
MOST_TOPICS = 1000
# of so many topics the log tells why they are not played
MOST_REASONS = 20


class BagPlayerNode(NodeShell):
    """
    Play a bag.

    Purpose: publish what was recorded, the same bytes in the same order, by log time or as fast
    as a driver answers the images.

    Publishes: the topics of the bag, with the QoS they were recorded with (the parameters
    `qos_overrides.*` change it); `/clock` if `clock_rate` is set (a recorded `/clock` is left out
    then); `/diagnostics`.

    Subscribes: with `answer_timeout`, `cmd_vel` beside each `image_raw`, and `q_values`, which are
    compared with the recorded ones.

    Services: `~/pause` (std_srvs/SetBool), `~/step` (std_srvs/Trigger): one message while paused;
    `~/hold` (std_srvs/SetBool): a slow learner holds the bag back.

    At a terminal: a line with the place in the bag; space pauses, arrows go 5 s back or on, s lets
    one message through, + and - change the rate, q ends.

    Parameters: `bags.settings.PlayerSettings`; `rate` can be changed while playing.

    Behaviour when things go wrong: a bag that cannot be read ends the node with one line and
    code 2; a topic whose type is not installed or whose name ROS refuses is left out with a
    warning. A subscriber that asks for more than was recorded hears nothing, which the log and
    the diagnostics say; topics that nobody heard are named at the end.
    """

    def __init__(self) -> None:
        """
        Open the bag and start to play.

        Raises:
            BagError: a bag that cannot be read, a topic that it does not have, or a name that a
                topic cannot have.
        """
        super().__init__('bag_player_node', PlayerSettings)
        settings = self.settings
        if not settings.bag:
            raise BagError('no bag was given; set the parameter `bag`')
        self._reader = BagReader(settings.bag)
        if settings.clock_rate > 0 and self._reader.end_time >= CLOCK_END:
            # rclpy would cut off the upper bits without a word
            raise BagError(f'{settings.bag} has times of {self._reader.end_time / 1e9:.0f} s; '
                           f'{CLOCK.name} can say {CLOCK_END / 1e9:.0f} s at most: play it '
                           'without clock_rate')
        self._remaps = parse_remaps(settings.remaps)
        for name in self._remaps:
            self._must_have(name)
        self._answers = Answers(settings.answer_timeout)
        # image topics whose messages a driver answers -> where
        self._answered: dict[str, Subscription] = {}
        # topics of recorded Q-values that are compared with new ones in place of being played
        self._compared: dict[str, Comparison] = {}
        self._outputs: dict[str, Publisher] = {}
        self._unconfirmed: Counter[str] = Counter()
        self._create_publishers(self._chosen_topics())
        self._listeners = Listeners(self, self._outputs)
        self._clock_message = Clock()
        clock = self.publisher(CLOCK) if settings.clock_rate > 0 else None
        self._clock_publisher = clock
        self._playback = Playback(
            self._publish, rate=self._rate(), paused=settings.start_paused,
            publish_clock=self._publish_clock, clock_rate=settings.clock_rate)
        self._start = self._reader.start_time + round(settings.start_offset * 1e9)
        self._stop = (self._start + round(settings.duration * 1e9) if settings.duration > 0
                      else None)
        self._error: BaseException | None = None
        self._done = threading.Event()
        self._closed = False
        self._gap_said = 0.0
        self._ahead: ReadAhead | None = None
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.serve_hold(lambda: self._playback.hold(self.held_back))
        self.create_service(Trigger, '~/step', self._on_step)
        self.create_timer(LOOK_SECONDS, self._look)
        self.create_timer(LISTENERS_SECONDS, self._listeners.look)
        self.get_logger().info(f'playing {len(self._outputs)} topics of {settings.bag}')
        self._terminal = PlayerTerminal(
            self._playback, self._start, self._stop or self._reader.end_time,
            set_rate=self._set_rate, quit_=self._quit)
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._play, name='bag_player', daemon=True)
        self._thread.start()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return how far it is and how late, and who cannot hear it."""
        middle, worst, _ = self._playback.timing_error(RECENT)
        unheard = self._listeners.mismatches
        level = DiagnosticStatus.WARN if unheard or self._answers.missing else DiagnosticStatus.OK
        if unheard:
            summary = '; '.join(unheard)
        elif self._answers.missing:
            summary = 'playing, but not every image is answered'
        else:
            summary = 'playing'
        return level, plain(summary, 300), {
            'position_seconds': max(self._playback.now - self._start, 0) / 1e9,
            'played': self._playback.played, 'unanswered': self._answers.missing,
            'timing_error_p50_ms': 1e3 * middle, 'timing_error_p99_ms': 1e3 * worst}

    def settings_changed(self) -> None:
        """Take over another rate."""
        self._playback.set_rate(self._rate())

    def close(self) -> None:
        """Stop, and say how it went."""
        if self._closed:
            return
        self._closed = True
        self._done.set()
        self._playback.stop()
        self._answers.stop()
        self._thread.join()
        self._terminal.close()
        seconds = time.monotonic() - self._began
        middle, worst, most = (1e3 * value for value in self._playback.timing_error())
        unanswered = (f'; {self._answers.missing} images were not answered'
                      if self.settings.answer_timeout else '')
        unheard = self._listeners.never_heard
        compared = ''.join(f'; {one.text()}' for one in self._compared.values() if one.text())
        nobody = f'; nobody listened to {plain(", ".join(unheard), 300)}' if unheard else ''
        say(f'{self._playback.played} messages played in {seconds:.2f} s; timing error p50 '
            f'{middle:.3f} ms, p99 {worst:.3f} ms, max {most:.3f} ms'
            f'{unanswered}{compared}{nobody}')
        self._reader.close()

    def _rate(self) -> float:
        return 0.0 if self.settings.answer_timeout else self.settings.rate

    def _set_rate(self, rate: float) -> None:
        # as anybody else would, so that the parameter says what is played
        self.set_parameters([Parameter('rate', value=rate)])

    def _quit(self) -> None:
        self._done.set()
        self._playback.stop()

    def _must_have(self, name: str) -> None:
        if name not in self._reader.topics:
            accepted = plain(', '.join(sorted(self._reader.topics)), 1000)
            raise BagError(f'{self.settings.bag} has no topic {plain(name)!r}; it has {accepted}')

    def _chosen_topics(self) -> list[str]:
        settings = self.settings
        if settings.topics.strip() == ALL:
            chosen = list(self._reader.topics)
        else:
            chosen = chosen_names(settings.topics, self.resolve_topic_name)
            for name in chosen:
                self._must_have(name)
        if len(chosen) > MOST_TOPICS:
            raise BagError(f'{settings.bag} has {len(chosen)} topics; accepted: {MOST_TOPICS}; '
                           'choose with the parameter `topics`')
        if settings.clock_rate > 0 and CLOCK.name in chosen:
            chosen.remove(CLOCK.name)
        if settings.answer_timeout:
            # who drives answers, and not the recorded drive
            of = {name: self._target(name).rpartition('/')[2] for name in chosen}
            self._compared = {name: Comparison() for name in chosen
                              if of[name] == Q_VALUES.name and self._reader.topics[
                                  name].type_name == Q_VALUES.type_name}
            chosen = [name for name in chosen if of[name] not in (CMD_VEL.name, Q_VALUES.name)]
        return chosen

    def _target(self, name: str) -> str:
        return self._remaps.get(name) or self.settings.prefix + name

    def _create_publishers(self, chosen: list[str]) -> None:
        sizes: dict[str, int] = {}
        for message in islice(self._reader.messages(chosen), FIRST_MESSAGES):
            sizes[message.topic] = max(sizes.get(message.topic, 1), len(message.data))
        for name in chosen:
            topic = self._reader.topics[name]
            try:
                if topic.encoding != ENCODING:
                    raise BagError(f'its encoding is {topic.encoding}, not {ENCODING}')
                self._outputs[name] = self._create_output(
                    message_class(topic.type_name), name, sizes.get(name, 1))
            except Exception as error:
                # of what a bag names anything may be wrong, and rcl and DDS raise as they like
                if self._target(name) != name:
                    raise BagError(f'{plain(name)} cannot be played as '
                                   f'{plain(self._target(name))!r}: {plain(str(error))}') from None
                self.counts['topics_not_played'] += 1
                if self.counts['topics_not_played'] <= MOST_REASONS:
                    self.get_logger().warn(
                        f'{plain(name)} is not played: {plain(str(error), 200)}')

    def _create_output(self, kind: type, name: str, size: int) -> Publisher:
        depths = {topic.name.lstrip('/'): topic.depth for topic in TOPICS if topic.latched}
        profile = offer_for(self._reader.topics[name].qos)
        if profile.durability == DurabilityPolicy.VOLATILE:
            profile.depth = max(LEAST_DEPTH, min(DEPTH, DEPTH_BYTES // size))
        else:
            # late subscribers get as many as the node that published it would have kept
            profile.depth = depths.get(name.rpartition('/')[2], profile.depth)
        target = self._target(name)
        publisher = self.create_publisher(
            kind, target, profile,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
        space, _, base = target.rpartition('/')
        if self.settings.answer_timeout and base == IMAGE.name:
            self._answered[name] = self.create_subscription(
                TwistStamped, f'{space}/{CMD_VEL.name}', self._answers.take,
                qos_profile_sensor_data, raw=True)
            for own, comparison in self._compared.items():
                if self._target(own) == f'{space}/{Q_VALUES.name}':
                    self.create_subscription(
                        JointState, self._target(own),
                        functools.partial(_hand_over, comparison.answered), COMPARED_DEPTH,
                        raw=True)
        return publisher

    def _play(self) -> None:
        try:
            self._wait_for_subscribers()
            self._terminal.waiting = ''
            place = self._start
            while not self._done.is_set():
                played = self._playback.played
                self._ahead = ReadAhead(
                    self._reader.messages(
                        [*self._outputs, *self._compared], place, self._stop))
                try:
                    self._playback.now = place
                    self._playback.play(self._ahead)
                finally:
                    self._ahead.close()
                begun, place = place, self._playback.wound()
                if place is None:
                    if (not self.settings.loop or not self._outputs
                            or self._plays_nothing(begun, played)):
                        break
                    place = self._start
            deadline = time.monotonic() + LAST_WORDS
            for publisher in self._outputs.values():
                left = deadline - time.monotonic()
                if left > 0 and not self._done.is_set():
                    publisher.wait_for_all_acked(Duration(seconds=left))
        except BaseException as error:
            # raised again where the executor sees it
            self._error = error
        finally:
            self._done.set()

    def _plays_nothing(self, begun: int, played: int) -> bool:
        """Return whether a whole pass played nothing, and say that it would go on for ever."""
        if begun != self._start or self._playback.played != played or self._done.is_set():
            return False
        self.get_logger().warn('there is no message in what is to be played again and again')
        return True

    def _wait_for_subscribers(self) -> None:
        seconds = self.settings.wait_for_subscribers
        self._terminal.waiting = f'waiting for subscribers, {seconds:g} s at most'
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self._done.is_set():
            if self._listeners.complete() and all(
                    one.get_publisher_count() for one in self._answered.values()):
                # that a driver is found does not mean that it has found us
                self._done.wait(MUTUAL_SECONDS if self._answered else 0)
                return
            time.sleep(0.01)

    def _look(self) -> None:
        """Show where it is, and end the node when everything has been played."""
        self._terminal.beat()
        self._say_gap()
        if self._done.is_set():
            if self._error is not None:
                raise self._error
            self._listeners.look()
            raise Finished

    def _say_gap(self) -> None:
        """Say that nothing comes for long: a clock may have been set while it was recorded."""
        due = self._playback.due
        rest = 0.0 if due is None else due - time.monotonic()
        if rest > GAP_SECONDS and due != self._gap_said:
            self._gap_said = due
            place = (self._playback.now - self._start) / NANOSECONDS
            self.get_logger().warn(
                f'no message for {rest:.0f} s: the bag is at {place:.1f} s and goes on at about '
                f'{place + rest * self._playback.rate:.0f} s, where start_offset may begin')

    def _publish(self, message: BagMessage) -> None:
        data = bytes(message.data)
        if message.topic in self._compared:
            _hand_over(self._compared[message.topic].recorded, data)
            return
        answered = message.topic in self._answered
        if answered:
            self._answers.expect(data)
        self._outputs[message.topic].publish(data)
        if answered:
            self._answers.wait()
        elif self._playback.unpaced:
            self._keep_pace_with_listeners(message.topic)

    def _keep_pace_with_listeners(self, name: str) -> None:
        """Let DDS bring what was published before more replaces it."""
        self._unconfirmed[name] += 1
        publisher = self._outputs[name]
        if self._unconfirmed[name] * CONFIRM_PART >= publisher.qos_profile.depth:
            self._unconfirmed[name] = 0
            publisher.wait_for_all_acked(CONFIRM_SECONDS)

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


def _hand_over(take: Callable[[int, dict[str, float]], None], data: bytes) -> None:
    """Let Q-values be compared; what is none is passed over."""
    with contextlib.suppress(BridgeError):
        bundle = decode_bundle(data, Q_VALUES.name)
        take(bundle.stamp, bundle.values_with())


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
