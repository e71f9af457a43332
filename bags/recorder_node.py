# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder: every topic of the graph, as raw bytes, into a rosbag2 MCAP bag."""
from __future__ import annotations

from collections.abc import Sequence
import contextlib
import ctypes
import dataclasses
import json
from operator import itemgetter
import os
import signal
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bags.errors import BagError
from msgs_bridge.transport.gathered_arrival import gather_arrivals
from bags.live_qos import meets, recorded_qos, request_for
from bags.qos_text import offered_qos
from bags.recording import Recording
from bags.settings import ALL, names_of, RecorderSettings
from bags.writer import BagWriter
from msgs_bridge.message_types import message_class
from msgs_bridge.node_shell import NodeShell, PolledGroup, run_node
from msgs_bridge.topics import TOPICS

# The middleware keeps what arrives between two looks; a look costs the same for one message as
# the executor's wait set does, so looking at 50 Hz instead of at every message saves most of it.
POLL_SECONDS = 0.02
DISCOVERY_SECONDS = 0.2
# On a busy machine the car and the learner come first: a lockstep run on two cores made a tenth
# more decisions/s beside a recorder of this priority than beside one of normal priority. A tenth
# of each core is left to it at least, which is enough to lose nothing.
NICE = 10
# Seconds after which discovery has found who was there before us, for Fast DDS announces a
# participant every 3 s; whoever publishes later should be heard from its first message on.
FOUND_SECONDS = 6.0
# Freed memory that is kept for the next chunk instead of being given back and zeroed anew, which
# is a third of the writing thread's work; names and numbers of mallopt(3).
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 32 << 20
# looks at the graph after which, if nothing was new, only every fifth is made
BUSY_DISCOVERIES = 50
CALM = 5
# seconds without a message after which a stopped recorder believes that nothing more comes
QUIET_SECONDS = 0.06
STOP_SECONDS = 0.6


@dataclasses.dataclass
class _Source:
    """One recorded topic."""

    name: str
    type_name: str
    request: Any
    subscription: Subscription
    number: int | None = None
    sequence: int = 0
    publishers: frozenset[bytes] = frozenset()
    # a latched publisher keeps less than it has sent
    latched: bool = False
    # whether we subscribed before anybody published, so that even number 1 should arrive
    first: bool = False

    @property
    def countable(self) -> bool:
        """Return whether sequence numbers tell what was lost: only those of one publisher do."""
        return len(self.publishers) == 1

    def see(self, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Note who publishes; after a change the numbers begin anew."""
        seen = frozenset(bytes(one.endpoint_gid) for one in publishers)
        if seen != self.publishers:
            self.first = self.first and not self.publishers
            self.publishers = seen
            self.sequence = 0


class BagRecorderNode(NodeShell):
    """
    Record topics to a bag.

    Purpose: a bag with every byte that was published, log time = when it arrived, publish time =
    when it was sent, QoS as the publishers offer it.

    Subscribes: the topics of the contract from the start, so that nothing is missed, and any
    other as it appears; `topics` and `exclude` choose.

    Publishes: `/diagnostics`.

    Parameters: `bags.settings.RecorderSettings`.

    Attributes:
        failed: whether the disk failed, so that messages are missing from the bag.

    Behaviour when things go wrong: an existing folder, a bad parameter or a failing disk ends the
    node with one line and code 2. Messages that DDS lost on the way (gaps in a single publisher's
    sequence numbers) are counted and logged. SIGINT and SIGTERM complete the bag.
    """

    def __init__(self) -> None:
        """
        Create the bag and start to record.

        Raises:
            BagError: the folder exists, or the provenance is not a JSON object.
        """
        super().__init__('bag_recorder_node', RecorderSettings)
        settings = self.settings
        folder = settings.folder or time.strftime('bag_%Y_%m_%d-%H_%M_%S')
        self._writer = BagWriter(
            folder, compression=settings.compression, chunk_bytes=settings.chunk_bytes,
            chunk_seconds=settings.chunk_seconds, split_bytes=settings.split_bytes,
            split_seconds=settings.split_seconds,
            custom_data=parse_provenance(settings.provenance))
        self._recording = Recording(self._writer, settings.cache_bytes)
        self._group = PolledGroup()
        self._lock = threading.Lock()
        self._sources: dict[str, _Source] = {}
        self._held: list[tuple[int, int, int, bytes]] = []
        self._unknown: set[str] = set()
        self._full_said = False
        self._discoveries = 0
        self._began = time.monotonic()
        self._gathering = False
        self._wanted = (
            None if settings.topics.strip() == ALL
            else {self.resolve_topic_name(name) for name in names_of(settings.topics)})
        self._excluded = {self.resolve_topic_name(name) for name in names_of(settings.exclude)}
        self._stop = threading.Event()
        self._closed = False
        self.failed = False
        self._subscribe_to_contract()
        self._thread = threading.Thread(target=self._poll_forever, name='bag_poll', daemon=True)
        self._thread.start()
        self.create_timer(DISCOVERY_SECONDS, self._discover)
        names = ', '.join(sorted(self._sources)) or 'nothing yet'
        self.get_logger().info(f'recording {names} to {self._writer.folder}')

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return messages, bytes waiting and losses."""
        level = DiagnosticStatus.OK
        if self._recording.full or any(key.startswith('lost_') for key in self.counts):
            level = DiagnosticStatus.WARN
        return level, 'recording', {
            'messages': self._writer.message_count,
            'topics': sum(source.number is not None for source in self._sources.values()),
            'peak_cache_bytes': self._recording.peak_bytes,
            'gathering': self._gathering,
        }

    def close(self) -> None:
        """Take what is still under way, complete the bag and say what is in it."""
        if self._closed:
            return
        self._closed = True
        for number in (signal.SIGINT, signal.SIGTERM):
            # a second Ctrl-C must not leave a bag without its end
            with contextlib.suppress(ValueError):
                signal.signal(number, signal.SIG_IGN)
        self._stop.set()
        self._thread.join()
        deadline = time.monotonic() + STOP_SECONDS
        quiet = time.monotonic() + QUIET_SECONDS
        while time.monotonic() < min(deadline, quiet):
            if self._poll(final=True):
                quiet = time.monotonic() + QUIET_SECONDS
            time.sleep(0.005)
        told = self._recording.error is not None
        try:
            self._recording.close()
        except BagError as error:
            self.failed = True
            if not told:
                sys.stderr.write(f'error: {error}\n')
            return
        missing = (self._wanted or set()) - self._sources.keys()
        if missing:
            sys.stderr.write(f'never seen: {", ".join(sorted(missing))}\n')
        lost = {key.removeprefix('lost_'): count for key, count in self.counts.items()
                if key.startswith('lost_')}
        loss = ', '.join(f'{count} of {topic}' for topic, count in lost.items()) or 'none'
        sys.stderr.write(
            f'{self._writer.message_count} messages in {self._writer.folder}; lost: {loss}\n')

    def _wants(self, name: str) -> bool:
        if name in self._excluded:
            return False
        if self._wanted is not None:
            return name in self._wanted
        # rosbag2 leaves out hidden topics too
        return not any(part.startswith('_') for part in name.split('/'))

    def _subscribe_to_contract(self) -> None:
        for topic in TOPICS:
            name = self.resolve_topic_name(topic.name)
            if self._wants(name):
                offered = offered_qos(reliable=topic.reliable, latched=topic.latched)
                self._subscribe(name, topic.type_name, [offered], latched=topic.latched)

    def _subscribe(
        self, name: str, type_name: str, offered: list[dict[str, Any]], *, latched: bool = True,
    ) -> None:
        try:
            kind = message_class(type_name)
        except (ImportError, AttributeError, ValueError):
            if name not in self._unknown:
                self._unknown.add(name)
                self.counts['topics_not_recorded'] += 1
                self.get_logger().error(
                    f'{name} is not recorded: its type {type_name} is not installed here')
            return
        with self._lock:
            old = self._sources.pop(name, None)
        if old is not None:
            # DDS refuses a second type of one topic within a process
            self.destroy_subscription(old.subscription)
        request = request_for(offered, self.settings.depth)
        source = _Source(name, type_name, request, self.create_subscription(
            kind, name, _unused, request, raw=True, callback_group=self._group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False)),
            latched=latched)
        if old is not None and old.type_name == type_name:
            source.number = old.number
        with self._lock:
            self._sources[name] = source
            if self._gathering:
                gather_arrivals(source.subscription, gather=True)

    def _discover(self) -> None:
        """Subscribe to what is new, and again where a publisher does not fit the request."""
        if self._recording.error is not None:
            raise BagError(self._recording.error)
        fresh = []
        self._discoveries += 1
        if self._discoveries > BUSY_DISCOVERIES and self._discoveries % CALM:
            return
        for name in self._known_topics():
            source = self._sources.get(name)
            if not self._wants(name) or name in self._unknown:
                continue
            # new publishers of a topic already recorded need not be noticed at once
            if source is not None and source.number is not None and self._discoveries % CALM:
                continue
            publishers = self._known_publishers(name)
            if not publishers:
                if source is not None and time.monotonic() - self._began > FOUND_SECONDS:
                    source.first = source.number is None and not source.latched
                continue
            offered = recorded_qos(publishers)
            if source is not None:
                source.see(publishers)
                types = {publisher.topic_type for publisher in publishers}
                if source.type_name in types and all(
                        meets(source.request, profile) for profile in offered):
                    continue
            self._subscribe(name, publishers[0].topic_type, offered)
            self._discoveries = 0
            fresh.append(name)
        if fresh:
            self.get_logger().info(f'recording {", ".join(sorted(fresh))}')

    def _known_topics(self) -> list[str]:
        """Return the topics of the graph; none when ROS is shutting down."""
        try:
            return [name for name, _ in self.get_topic_names_and_types()]
        except Exception:
            # a signal may shut ROS down in the middle of any call, and calls differ in what they
            # raise then
            if self.context.ok():
                raise
            return []

    def _known_publishers(self, name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic; none when ROS is shutting down."""
        try:
            return self.get_publishers_info_by_topic(name)
        except Exception:
            # as above
            if self.context.ok():
                raise
            return []

    def _poll_forever(self) -> None:
        looked = time.monotonic()
        while not self._stop.wait(POLL_SECONDS):
            if self._recording.full:
                if not self._full_said:
                    self._full_said = True
                    self.counts['cache_full'] += 1
                    self.get_logger().warn('the disk is too slow: messages wait in DDS')
                continue
            self._full_said = False
            taken = self._poll()
            before, looked = looked, time.monotonic()
            self._gather_if_busy(taken / (looked - before))
        self._gather_if_busy(0)

    def _gather_if_busy(self, messages_per_second: float) -> None:
        # a lower bound for the way back, so that it does not come and go
        bound = self.settings.gather_above / (2 if self._gathering else 1)
        busy = bool(bound) and messages_per_second > bound
        if busy == self._gathering:
            return
        with self._lock:
            self._gathering = busy
            for source in self._sources.values():
                gather_arrivals(source.subscription, gather=busy)

    def _poll(self, *, final: bool = False) -> int:
        """
        Take everything that has arrived; return how many messages.

        What arrived after this look began is held until the next one, so that log times never
        go back in the bag although topics are emptied one after another.
        """
        began = time.time_ns()
        batch = self._held
        before = len(batch)
        with self._lock:
            sources = list(self._sources.values())
            for source in sources:
                self._take(source, batch)
        taken = len(batch) - before
        if batch:
            batch.sort(key=itemgetter(0))
            split = len(batch)
            while split and batch[split - 1][0] > began and not final:
                split -= 1
            self._held = batch[split:]
            del batch[split:]
            if batch:
                self._recording.put(batch)
        return taken

    def _take(self, source: _Source, batch: list[tuple[int, int, int, bytes]]) -> None:
        subscription = source.subscription
        kind = subscription.msg_type
        with subscription.handle:
            take = subscription.handle.take_message
            while (taken := take(kind, True)) is not None:
                data, info = taken
                if source.number is None:
                    self._announce(source)
                sequence = info['publication_sequence_number'] or 0
                if sequence != source.sequence + 1 and (source.sequence or source.first):
                    self._check_gap(source, sequence)
                source.sequence = sequence
                batch.append((
                    info['received_timestamp'] or time.time_ns(), info['source_timestamp'],
                    source.number, data))

    def _announce(self, source: _Source) -> None:
        """Give a topic its place in the bag, with the QoS of its publishers."""
        publishers = self._known_publishers(source.name)
        source.see(publishers)
        offered = recorded_qos(publishers) or [offered_qos()]
        source.number = self._recording.add_topic(source.name, source.type_name, offered)

    def _check_gap(self, source: _Source, sequence: int) -> None:
        """Count what is missing before a message, if all came from one publisher."""
        before = source.sequence
        source.see(self._known_publishers(source.name))
        if not source.countable or source.sequence != before or not (before or source.first):
            return
        lost = sequence - before - 1
        if lost <= 0:
            return
        self.counts[f'lost_{source.name}'] += lost
        self.get_logger().warn(
            f'{source.name}: {lost} messages were lost on the way to the recorder',
            throttle_duration_sec=5.0)


def parse_provenance(text: str) -> dict[str, str]:
    """
    Return the entries of a JSON object as texts; an empty text has none.

    Raises:
        BagError: not a JSON object.
    """
    if not text:
        return {}
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BagError(f'provenance is not JSON: {error}') from None
    if not isinstance(values, dict):
        raise BagError('provenance is not a JSON object')
    return {key: value if isinstance(value, str) else json.dumps(value)
            for key, value in values.items()}


def _unused(message: object) -> None:
    """Stand in for a callback: the subscriptions are polled."""


def _keep_freed_memory() -> None:
    # only glibc has it
    with contextlib.suppress(AttributeError):
        set_option = ctypes.CDLL(None).mallopt
        for option in (M_TRIM_THRESHOLD, M_MMAP_THRESHOLD):
            set_option(option, KEPT_BYTES)


def main(args: list[str] | None = None) -> int:
    """Run the recorder; the exit code is 2 if the bag could not be completed."""
    os.nice(NICE)
    _keep_freed_memory()
    nodes = []

    def make_node() -> BagRecorderNode:
        nodes.append(BagRecorderNode())
        return nodes[0]

    code = run_node(make_node, args)
    return 2 if any(node.failed for node in nodes) else code


if __name__ == '__main__':
    sys.exit(main())
