# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Takes what waits in the middleware, in order of arrival, and hands it to a recording."""
from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path
import threading
import time

from bags.live_qos import recorded_qos
from bags.log_time import SimulationTime
from bags.mcap_records import MAX_CHUNK
from bags.qos_text import offered_qos
from bags.recorded_topic import RecordedTopic
from bags.recording import Entry, Recording
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

# The middleware keeps what arrives between two looks; a look costs the same for one message as
# the executor's wait set does, so looking at 50 Hz instead of at every message saves most of it.
POLL_SECONDS = 0.02
# pause between two looks when the first has left something
SHORT_SECONDS = 0.001
# bytes that one topic may bring in a look before the others have their turn
LOOK_BYTES = 16 << 20
# a chunk with a larger message could not be read again
MAX_MESSAGE = MAX_CHUNK // 2
# publishers stamp what they like; a bag holds times of 63 bits
LAST_TIME = 2 ** 63 - 1
# Seconds without a message from before the end after which a stopped recorder believes that
# nothing more comes, if the middleware's threads have nothing to do either. What a socket had
# no room for is sent again when the publisher's next heartbeat says so, every 0.2 s by the profile
# of ours; where a look came late, publishers may be, too.
QUIET_SECONDS = 0.25
LATE_QUIET_SECONDS = 0.5
LATE_SECONDS = 0.15
# for how long a late look matters; Fast DDS by itself has a heartbeat each 3 s
LATE_MATTERS_SECONDS = 3.2
STOP_SECONDS = 0.9
# nothing is under way for so long, whatever a publisher says of its time; ns
UNDER_WAY = 60 * 10 ** 9


class Intake:
    """
    Empties the subscriptions of all topics in a thread of its own.

    Attributes:
        topics: name -> topic; the node adds to it while the thread runs.
        drained: subscriptions that are empty and not needed any more, for the node to destroy.
        error: what ended the thread, if anything did.
        lock: held while a topic is emptied; whoever destroys a subscription takes it.
        failed_takes: messages that the middleware could not hand over.
    """

    def __init__(
        self,
        recording: Recording,
        publishers_of: Callable[[str], Sequence[TopicEndpointInfo]],
        *,
        depth: int,
    ) -> None:
        """
        Prepare; `start` begins.

        Args:
            recording: takes the messages.
            publishers_of: returns who publishes a topic.
            depth: messages that may wait in a subscription.
        """
        self.topics: dict[str, RecordedTopic] = {}
        self.drained: deque[Subscription] = deque()
        self.error: Exception | None = None
        self.lock = threading.Lock()
        self.failed_takes = 0
        self._recording = recording
        self._publishers_of = publishers_of
        self._depth = depth
        self._time: SimulationTime | None = None
        self._held: list[Entry] = []
        self._held_bytes = 0
        self._room = 0
        self._cut_short = False
        self._looked = time.monotonic()
        self._late_at = -LATE_MATTERS_SECONDS
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='bag_intake', daemon=True)

    @property
    def waits_for_clock(self) -> bool:
        """Return whether messages wait for the first word of `/clock`."""
        return self._time is not None and self._time.now is None

    def time_by(self, clock: RecordedTopic) -> None:
        """Make simulation time the log time."""
        self._time = SimulationTime(clock)

    def start(self) -> None:
        """Begin to take messages."""
        self._thread.start()

    def finish(self) -> bool:
        """
        Take what is still under way and hand over everything.

        Returns:
            whether nothing from before the end can be under way any more.
        """
        self._stop.set()
        self._thread.join()
        ended = time.time_ns()
        began = quiet_since = time.monotonic()
        quiet, rest = 0.0, False
        while not rest and time.monotonic() - began < STOP_SECONDS:
            if any(ended - UNDER_WAY < sent <= ended for _, sent, _, _ in self._look()):
                quiet_since = time.monotonic()
            quiet = time.monotonic() - quiet_since
            rest = quiet > self._quiet_seconds() and not self._cut_short and middleware_at_rest()
            time.sleep(SHORT_SECONDS)
        self._hand_over(self._held)
        # of a graph that goes on nothing from before the end comes any more, though it never rests
        return rest or quiet > self._quiet_seconds()

    def _quiet_seconds(self) -> float:
        """Return after how long without a message nothing is under way."""
        late = time.monotonic() - self._late_at < LATE_MATTERS_SECONDS
        return LATE_QUIET_SECONDS if late else QUIET_SECONDS

    def _run(self) -> None:
        try:
            while not self._stop.wait(SHORT_SECONDS if self._cut_short else POLL_SECONDS):
                self._look()
        except Exception as error:
            # raised again where the executor sees it
            self.error = error

    def _look(self) -> list[Entry]:
        """
        Take what has arrived; return it.

        What arrived after this look began is held until the next one, and so is what is newer
        than the rest of a topic that was not emptied: so log times never go back in the bag
        although topics are emptied one after another.
        """
        now = time.monotonic()
        if now - self._looked > LATE_SECONDS:
            self._late_at = now
        self._looked = now
        until = time.time_ns()
        self._room = self._recording.room - self._held_bytes
        self._cut_short = False
        taken: list[Entry] = []
        for topic in list(self.topics.values()):
            reached = self._take(topic, taken)
            self._cut_short |= reached < LAST_TIME
            until = min(until, reached)
        if not taken and not self._held:
            return taken
        batch = self._held + taken
        batch.sort(key=itemgetter(0))
        # until somebody says the simulation's time, everything waits for it
        known = self._time is None or self._time.begin(batch)
        split = bisect_right(batch, until, key=itemgetter(0)) if known else 0
        self._held = batch[split:]
        self._held_bytes = sum(len(entry[3]) for entry in self._held)
        self._hand_over(batch[:split])
        return taken

    def _hand_over(self, batch: list[Entry]) -> None:
        if batch and self._time is not None:
            batch = self._time.apply(batch)
        if batch:
            self._recording.put(batch)

    def _take(self, topic: RecordedTopic, entries: list[Entry]) -> int:
        """Take what waits in a topic, within bounds; return up to which time of arrival."""
        with self.lock:
            while topic.retired:
                reached = self._empty(topic, topic.retired[0], entries)
                if reached < LAST_TIME:
                    return reached
                self.drained.append(topic.retired.popleft())
            return min((self._empty(topic, ear, entries) for ear in topic.ears.values()),
                       default=LAST_TIME)

    def _empty(self, topic: RecordedTopic, ear: Subscription, entries: list[Entry]) -> int:
        size = 0
        reached = LAST_TIME
        try:
            with ear.handle:
                take = ear.handle.take_message
                # who publishes faster than this must not keep the others from being heard
                for _ in range(self._depth):
                    taken = take(topic.message_type, True)
                    if taken is None:
                        return LAST_TIME
                    size += len(taken[0])
                    reached = self._accept(topic, *taken, entries)
                    if size > LOOK_BYTES:
                        break
        except Exception:
            # one message that the middleware cannot hand over, or a subscription that is gone
            self.failed_takes += 1
            return LAST_TIME
        return reached

    def _accept(
        self, topic: RecordedTopic, data: bytes, info: dict, entries: list[Entry],
    ) -> int:
        """Add a message to the entries if it is new and fits; return when it arrived."""
        sent = info['source_timestamp'] or 0
        sequence = info['publication_sequence_number'] or 0
        received = info['received_timestamp'] or time.time_ns()
        if topic.is_repeat(sent, sequence):
            return received
        if topic.number is None and topic.kept:
            self._announce(topic)
        if sequence != topic.sequence + 1 and topic.kept:
            self._check_gap(topic, sequence)
        topic.sequence = sequence
        size = len(data)
        topic.largest = max(topic.largest, size)
        # an empty cache takes one message of any size
        if size > MAX_MESSAGE or self._recording.cache_bytes > self._room < size:
            topic.did_not_fit += 1
            return received
        self._room -= size
        entries.append((received, sent if 0 < sent <= LAST_TIME else received,
                        topic.number, data))
        return received

    def _announce(self, topic: RecordedTopic) -> None:
        """Give a topic its place in the bag, with the QoS of its publishers."""
        publishers = self._publishers_of(topic.name)
        topic.see(publishers)
        topic.profiles = recorded_qos(publishers) or [offered_qos()]
        topic.number = self._recording.add_topic(topic.name, topic.type_name, topic.profiles)

    def _check_gap(self, topic: RecordedTopic, sequence: int) -> None:
        if not topic.countable or not (topic.sequence or topic.first):
            return
        # the gap may be another publisher's number
        topic.see(self._publishers_of(topic.name))
        topic.count_gap(sequence)


def middleware_at_rest() -> bool:
    """
    Return whether no thread but Python's has anything to do.

    A thread of the middleware that a busy machine does not let run has messages in its hands that
    nobody else can see yet.
    """
    ours = {thread.native_id for thread in threading.enumerate()}
    for path in Path('/proc/self/task').glob('[0-9]*/stat'):
        try:
            # PID (NAME) STATE ..., see proc(5); S is a thread that waits
            state = path.read_text().rpartition(')')[2].split()[0]
        except (OSError, IndexError):
            continue
        if state != 'S' and int(path.parent.name) not in ours:
            return False
    return True
