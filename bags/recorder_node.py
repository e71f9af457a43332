# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder: every topic of the graph, as raw bytes, into a rosbag2 MCAP bag."""
from __future__ import annotations

from collections.abc import Sequence
import contextlib
import os
import signal
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bags.errors import BagError
from bags.intake import Intake
from bags.live_line import LiveLine
from bags.live_qos import join_profiles, Kind, kinds_of, recorded_qos, request_for
from bags.own_memory import let_go_of_freed_memory, resident_bytes
from bags.provenance import parse_provenance
from bags.recorded_topic import RecordedTopic
from bags.recorder_terminal import recorded_text, waits_for
from bags.recording import Recording
from bags.settings import ALL, chosen_names, RecorderSettings, resolved_names
from bags.writer import BagWriter
from msgs_bridge.last_line import say
from msgs_bridge.matching import NamesHidden, topics_of
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import NodeShell, PolledGroup, run_node
from msgs_bridge.plain_text import plain
from msgs_bridge.topics import CLOCK, CMD_VEL, IMAGE, TOPICS

DISCOVERY_SECONDS = 0.2
# On a busy machine the car and the learner come first: a lockstep run on two cores made a tenth
# more decisions/s beside a recorder of this priority than beside one of normal priority. A tenth
# of each core is left to it at least, which is enough to lose nothing.
NICE = 10
# Seconds after which discovery has found who was there before us, for Fast DDS announces a
# participant every 3 s; whoever publishes later should be heard from its first message on.
FOUND_SECONDS = 6.0
# looks at the graph after which, if nothing was new, only every fifth is made
BUSY_DISCOVERIES = 50
CALM = 5
# more topics than this are no graph but a flood of names
MOST_TOPICS = 1000
# of so many topics the log tells why they are not recorded
MOST_REASONS = 20
# after so many seconds without progress the disk is said to be stuck
STALLED_SECONDS = 2.0
LOSS_LOG_SECONDS = 5.0
# how often a terminal is told how large the bag is
SIZE_SECONDS = 1.0
# What DDS keeps is bounded in messages, not in bytes: `depth` images of 50 MB are 100 GB. Above
# so many bytes besides those of the cache, what waits there is dropped.
MOST_WAITING_BYTES = 256 << 20
# topics whose messages are no larger than this are spared as long as that is enough
SMALL_BYTES = 64 << 10
LEAST_FLOOD_BYTES = 4 << 20


class BagRecorderNode(NodeShell):
    """
    Record topics to a bag.

    Purpose: a bag with every byte that was published, log time = when it arrived (with
    `use_sim_time` the time of the simulation then), publish time = when it was sent, QoS as the
    publishers offer it.

    Subscribes: the topics of the contract from the start, so that nothing is missed, and any
    other as it appears; `topics` and `exclude` choose. It asks each publisher for what it offers.

    Publishes: `/diagnostics`.

    Parameters: `bags.settings.RecorderSettings`.

    Behaviour when things go wrong: an existing folder, a bad parameter, a failing disk or a bag
    that was removed ends the node with one line and code 2, after an ERROR in the diagnostics. A
    topic that cannot be recorded is named once. What DDS lost on the way (gaps in a single
    publisher's sequence numbers) and what the cache did not hold is counted by topic, logged, and
    kept in the bag's `custom_data`. SIGINT, SIGTERM and SIGHUP complete the bag.
    """

    def __init__(self) -> None:
        """
        Create the bag and start to record.

        Raises:
            BagError: the folder exists, a topic name that ROS refuses, or a provenance that is
                not a JSON object.
        """
        super().__init__('bag_recorder_node', RecorderSettings)
        settings = self.settings
        self._wanted = (
            None if settings.topics.strip() == ALL
            else set(chosen_names(settings.topics, self.resolve_topic_name)))
        self._excluded = set(resolved_names(settings.exclude, self.resolve_topic_name))
        folder = settings.folder or time.strftime('bag_%Y_%m_%d-%H_%M_%S')
        provenance = parse_provenance(settings.provenance)
        self._writer = BagWriter(
            folder, compression=settings.compression, chunk_bytes=settings.chunk_bytes,
            chunk_seconds=settings.chunk_seconds, split_bytes=settings.split_bytes,
            split_seconds=settings.split_seconds, custom_data=provenance)
        self._recording = Recording(self._writer, settings.cache_bytes)
        self._group = PolledGroup()
        self._refused: set[tuple[str, str]] = set()
        self._said_waiting = ''
        self._discoveries = 0
        self._losses_said = (0, 0.0)
        self._most_bytes = resident_bytes() + settings.cache_bytes + MOST_WAITING_BYTES
        self._dropped_at = 0.0
        self._closed = False
        self._clock_name = (
            CLOCK.name if self.get_parameter('use_sim_time').value else None)
        self._intake = Intake(self._recording, self._publishers_of, depth=settings.depth)
        self._subscribe_to_contract()
        self._intake.start()
        self.create_timer(DISCOVERY_SECONDS, self._discover)
        self._began = time.monotonic()
        self._line = LiveLine()
        self._size = (0.0, 0)
        names = ('every topic as it appears' if self._wanted is None
                 else plain(', '.join(sorted(self._wanted)), 1000))
        # said when it runs: a signal that comes before leaves nobody to complete the bag
        self._announcement = f'recording {names} to {self._writer.folder}'

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return messages, bytes waiting and losses, and what keeps the bag from growing."""
        lost = self._lost()
        stalled = self._recording.stalled_seconds
        error = self._recording.error or self._intake.error
        if error is not None:
            level, summary = DiagnosticStatus.ERROR, str(error)
        elif stalled > STALLED_SECONDS:
            level, summary = (
                DiagnosticStatus.ERROR, f'the disk has taken nothing for {stalled:.0f} s')
        elif self._intake.waits_for_clock:
            level, summary = (
                DiagnosticStatus.WARN, f'messages wait until somebody publishes {CLOCK.name}')
        elif lost:
            level, summary = DiagnosticStatus.WARN, 'recording, but messages were lost'
        elif waiting := self._waiting():
            level, summary = DiagnosticStatus.OK, waiting
        else:
            level, summary = DiagnosticStatus.OK, 'recording'
        topics = self._intake.topics.values()
        return level, summary, {
            'messages': self._writer.message_count,
            'topics': sum(topic.number is not None for topic in list(topics)),
            'peak_cache_bytes': self._recording.peak_bytes,
            'failed_takes': self._intake.failed_takes,
            **{f'lost_{name}': count for name, count in lost.items()},
        }

    def close(self) -> None:
        """
        Take what is still under way, complete the bag and say what is in it.

        Raises:
            BagError: the bag could not be completed; the text says what was lost.
        """
        if self._closed:
            return
        self._closed = True
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # a second Ctrl-C must not leave a bag without its end
            with contextlib.suppress(ValueError):
                signal.signal(number, signal.SIG_IGN)
        self._line.close()
        settled = self._intake.finish()
        lost = self._lost()
        self._recording.close(lost)
        missing = (self._wanted or set()) - self._intake.topics.keys()
        if missing:
            say(f'never seen: {", ".join(sorted(missing))}')
        if self._intake.waits_for_clock:
            say(f'nobody published {CLOCK.name}: log times are those of the wall clock')
        loss = ', '.join(f'{count} of {topic}' for topic, count in lost.items()) or 'none'
        if not settled:
            loss += ' known, but messages were still arriving late'
        unsure = sorted(topic.name for topic in self._intake.topics.values() if topic.unsure)
        if unsure:
            loss += (f'; nobody could count what was lost of {plain(", ".join(unsure), 300)} when '
                     'memory was full')
        say(f'{self._writer.message_count} messages in {self._writer.folder}; lost: {loss}')

    def _waiting(self) -> str:
        """Return what nothing has come of, '' before discovery has had its time."""
        if time.monotonic() - self._began < FOUND_SECONDS:
            return ''
        topics = list(self._intake.topics.values())
        return waits_for(
            self._wanted, [topic.name for topic in topics if topic.number is not None],
            [topic.name for topic in topics if topic.publishers],
            os.environ.get('ROS_DOMAIN_ID') or '0')

    def _tell(self) -> None:
        """Show on a terminal what was recorded so far; log what is waited for, each once."""
        now = time.monotonic()
        waiting = self._waiting()
        if waiting and waiting != self._said_waiting:
            self._said_waiting = waiting
            self.get_logger().info(waiting, throttle_duration_sec=LOSS_LOG_SECONDS)
        if self._line.there:
            if now - self._size[0] > SIZE_SECONDS:
                # a bag that was removed is told of elsewhere
                with contextlib.suppress(OSError):
                    self._size = (now, sum(
                        path.stat().st_size for path in self._writer.folder.glob('*.mcap')))
            topics = sum(topic.number is not None for topic in list(self._intake.topics.values()))
            self._line.show(waiting or recorded_text(
                now - self._began, self._writer.message_count, topics, self._size[1],
                sum(self._lost().values())) + ' | Ctrl-C ends')

    def _wants(self, name: str) -> bool:
        if name in self._excluded:
            return False
        if self._wanted is not None:
            return name in self._wanted
        # rosbag2 leaves out hidden topics too
        return not any(part.startswith('_') for part in name.split('/'))

    def _lost(self) -> dict[str, int]:
        return {topic.name: topic.lost for topic in list(self._intake.topics.values())
                if topic.lost}

    def _subscribe_to_contract(self) -> None:
        # Simulator and policy begin once they are heard on these. Subscriptions make themselves
        # known in their order, so that by then the others are heard, too.
        waited_for = (IMAGE, CMD_VEL)
        for topic in sorted(TOPICS, key=waited_for.__contains__):
            name = self.resolve_topic_name(topic.name)
            if self._wants(name) or topic.name == self._clock_name:
                kind = Kind(topic.reliable, topic.latched)
                self._listen(name, topic.type_name, frozenset({kind}), latched=topic.latched)
                if topic.name == self._clock_name:
                    self._intake.time_by(self._intake.topics[name])

    def _listen(
        self, name: str, type_name: str, kinds: frozenset[Kind], *, latched: bool,
    ) -> RecordedTopic | None:
        """Subscribe to a topic for these kinds of publishers; None if that cannot be."""
        topic = self._intake.topics.get(name)
        if topic is not None and topic.type_name != type_name:
            # DDS refuses a second type of one topic within a process
            topic = self._forget(topic)
        try:
            if topic is None:
                topic = RecordedTopic(
                    name, type_name, message_class(type_name), latched=latched,
                    depth=self.settings.depth, kept=self._wants(name))
            ears = dict(topic.ears)
            for kind in kinds - ears.keys():
                ears[kind] = self._subscription(topic, kind)
        except Exception as error:
            # of what the wire names anything may be wrong, and rcl and DDS raise as they like
            if self.context.ok():
                self._refuse(name, type_name, str(error))
            return None
        with self._intake.lock:
            topic.listen_with({kind: ears[kind] for kind in kinds})
        self._intake.topics[name] = topic
        return topic

    def _subscription(self, topic: RecordedTopic, kind: Kind) -> Subscription:
        return self.create_subscription(
            topic.message_type, topic.name, _unused, request_for(kind, self.settings.depth),
            raw=True, callback_group=self._group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))

    def _forget(self, topic: RecordedTopic) -> None:
        """End the subscriptions of a topic of which nothing has come."""
        with self._intake.lock:
            del self._intake.topics[topic.name]
            for ear in topic.ears.values():
                self.destroy_subscription(ear)

    def _refuse(self, name: str, type_name: str, reason: str) -> None:
        """Leave a topic out of the bag from now on, and say so once."""
        if (name, type_name) in self._refused or len(self._refused) >= MOST_TOPICS:
            return
        self._refused.add((name, type_name))
        self.counts['topics_not_recorded'] += 1
        if len(self._refused) <= MOST_REASONS:
            self.get_logger().error(f'{plain(name)} is not recorded: {plain(reason, 200)}')

    def _discover(self) -> None:
        """Subscribe to what is new, and anew where a publisher offers something else."""
        if self._announcement:
            self.get_logger().info(self._announcement)
            self._announcement = ''
        self._end_if_broken()
        self._say_losses()
        self._bound_memory()
        self._tell()
        while self._intake.drained:
            self.destroy_subscription(self._intake.drained.popleft())
        self._discoveries += 1
        if self._discoveries > BUSY_DISCOVERIES and self._discoveries % CALM:
            return
        fresh = []
        for name in self._names():
            topic = self._intake.topics.get(name)
            if topic is None and not self._wants(name):
                continue
            # new publishers of a topic already recorded need not be noticed at once
            if topic is not None and topic.number is not None and self._discoveries % CALM:
                continue
            if self._follow(name, topic):
                fresh.append(plain(name))
                self._discoveries = 0
        if fresh:
            self.get_logger().info(f'recording {plain(", ".join(sorted(fresh)), 1000)}')

    def _follow(self, name: str, topic: RecordedTopic | None) -> bool:
        """Go by who publishes a topic now; return whether that made a new subscription."""
        publishers = self._publishers_of(name)
        if not publishers:
            if topic is not None and time.monotonic() - self._began > FOUND_SECONDS:
                topic.first = topic.number is None and not topic.latched
            return False
        type_name = self._type_of(name, topic, publishers)
        if type_name is None:
            return False
        profiles = recorded_qos([one for one in publishers if one.topic_type == type_name])
        kinds = kinds_of(profiles)
        if topic is not None and topic.type_name == type_name:
            topic.see(publishers)
            self._add_offers(topic, profiles)
            if topic.ears.keys() == kinds:
                return False
        elif len(self._intake.topics) + len(self._refused) >= MOST_TOPICS:
            self.counts['too_many_topics'] = 1
            return False
        latched = any(kind.latched for kind in kinds)
        return self._listen(name, type_name, kinds, latched=latched) is not None

    def _type_of(
        self, name: str, topic: RecordedTopic | None, publishers: Sequence[TopicEndpointInfo],
    ) -> str | None:
        """Return the type to record a topic as, which it keeps from its first message on."""
        types = dict.fromkeys(one.topic_type for one in publishers)
        if topic is not None and (topic.number is not None or topic.type_name in types):
            types.pop(topic.type_name, None)
            for other in types:
                self._refuse(name, other, f'it is {topic.type_name} in this bag, not {other}')
            return topic.type_name if topic.type_name in {
                one.topic_type for one in publishers} else None
        return next((one for one in types if (name, one) not in self._refused), None)

    def _add_offers(self, topic: RecordedTopic, profiles: list[dict[str, Any]]) -> None:
        """Keep the QoS of publishers that came after the first message."""
        joined = join_profiles(topic.profiles, profiles)
        if topic.number is not None and len(joined) > len(topic.profiles):
            topic.profiles = joined
            self._recording.add_offers(topic.number, joined)

    def _end_if_broken(self) -> None:
        """
        Say it in the diagnostics and end the node when the bag can no longer be written.

        Raises:
            BagError: what went wrong and what it has cost.
        """
        if self._intake.error is not None:
            self.publish_diagnostics()
            raise BagError(f'recording ended: {self._intake.error!r}')
        if self._recording.error is not None:
            self.publish_diagnostics()
            raise BagError(self._recording.error)

    def _bound_memory(self) -> None:
        """Drop what waits in DDS when it is too much, with the subscriptions that hold it."""
        now = time.monotonic()
        since = now - self._dropped_at
        if since < 1.0 or resident_bytes() < self._most_bytes:
            return
        self._dropped_at = now
        floods = []
        # a topic of which nothing has come may hold the pieces of what is too large to come
        suspects = [topic for topic in self._intake.topics.values() if topic.publishers and (
            since < 5.0 or topic.number is None or topic.largest > SMALL_BYTES)]
        for topic in sorted(suspects, key=lambda topic: -topic.largest):
            before = resident_bytes()
            if before < self._most_bytes:
                break
            self._listen_anew(topic)
            let_go_of_freed_memory()
            if before - resident_bytes() > LEAST_FLOOD_BYTES:
                # nobody knows how many there were
                topic.did_not_fit += 1
                floods.append(plain(topic.name))
        self.counts['backlogs_dropped'] += len(floods)
        if floods:
            self.get_logger().warn(f'a flood: what waited in DDS of {", ".join(floods)} was '
                                   'dropped, for memory is bounded')

    def _listen_anew(self, topic: RecordedTopic) -> None:
        """Replace the subscriptions of a topic and forget what waits in them."""
        with self._intake.lock:
            # all of them before the first new one: DDS keeps one pool of memory a topic
            for ear in (*topic.ears.values(), *topic.retired):
                self.destroy_subscription(ear)
            topic.retired.clear()
            topic.listen_anew({kind: self._subscription(topic, kind) for kind in topic.ears})

    def _say_losses(self) -> None:
        now = time.monotonic()
        said, when = self._losses_said
        topics = list(self._intake.topics.values())
        lost = sum(topic.lost for topic in topics)
        if lost == said or now < when + LOSS_LOG_SECONDS:
            return
        self._losses_said = (lost, now)
        no_room = sum(topic.did_not_fit for topic in topics)
        worst = max(topics, key=lambda topic: topic.lost)
        self.get_logger().warn(
            f'{lost} messages were lost so far, most of them of {plain(worst.name)}: '
            f'{no_room} because the cache was full, the others on the way to the recorder')

    def _names(self) -> set[str]:
        """Return the topics of the graph; none when ROS is shutting down."""
        try:
            return set(topics_of(self))
        except NamesHidden as error:
            self.counts['failed_looks'] += 1
            self.get_logger().warn(
                f'the names of the graph cannot be read, only those of each node: '
                f'{plain(str(error))}', throttle_duration_sec=LOSS_LOG_SECONDS)
            return error.names.keys() | self._intake.topics.keys()

    def _publishers_of(self, name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic; none when ROS is shutting down or refuses the name."""
        try:
            return self.get_publishers_info_by_topic(name)
        except Exception as error:
            if self.context.ok() and name not in self._intake.topics:
                self._refuse(name, '', str(error))
            return []


def _unused(message: object) -> None:
    """Stand in for a callback: the subscriptions are polled."""


def main(args: list[str] | None = None) -> int:
    """Run the recorder; the exit code is 2 if the bag could not be completed."""
    os.nice(NICE)
    return run_node(BagRecorderNode, args)


if __name__ == '__main__':
    sys.exit(main())
