# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""One recorded topic: its subscriptions, its publishers, and what was lost of it."""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

from bags.live_qos import Kind
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo


class RecordedTopic:
    """
    A topic that is recorded.

    It has a subscription for each kind of publisher (reliable or not, latched or not), so that a
    best-effort one beside a reliable one is heard and costs the other nothing. What comes twice
    then is known by its publisher's time and number.

    Attributes:
        name, type_name, message_type: of its messages.
        ears: kind of publisher -> subscription.
        retired: subscriptions that nobody needs any more, to be emptied before they go.
        kept: whether it goes into the bag, and is not only listened to.
        number: its place in the bag; None until its first message.
        profiles: QoS of its publishers as it stands in the bag.
        publishers: who publishes it, as far as discovery knows.
        latched: whether a publisher keeps less than it has sent.
        first: whether we subscribed before anybody published, so that even number 1 should come.
        largest: bytes of the largest message seen.
        sequence: number of the newest message; 0 when it is not known.
        unsure: whether more may be lost than is counted: it was listened to anew while no number
            told what would come next.
        lost_on_the_way: messages that DDS has not brought.
        did_not_fit: messages that came while the cache was full, or too large for a bag; a
            backlog that was dropped unseen counts as one.
    """

    def __init__(
        self, name: str, type_name: str, message_type: type, *,
        latched: bool, depth: int, kept: bool = True,
    ) -> None:
        """Begin without subscriptions; `depth` is how many messages wait in each."""
        self.name = name
        self.type_name = type_name
        self.message_type = message_type
        self.latched = latched
        self.kept = kept
        self.ears: dict[Kind, Subscription] = {}
        self.retired: deque[Subscription] = deque()
        self.number: int | None = None
        self.profiles: list[dict[str, Any]] = []
        self.publishers: frozenset[bytes] = frozenset()
        self.first = False
        self.largest = 0
        self.sequence = 0
        self.unsure = False
        self.lost_on_the_way = 0
        self.did_not_fit = 0
        # marks of what came last, for the moment when a second subscription brings it again
        self._marks: deque[tuple[int, int]] = deque(maxlen=depth)
        self._seen: set[tuple[int, int]] | None = None
        self._renewed = False

    @property
    def lost(self) -> int:
        """Return how many messages are known to be missing in the bag."""
        return self.lost_on_the_way + self.did_not_fit

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

    def listen_with(self, ears: dict[Kind, Subscription]) -> None:
        """Go on with these subscriptions; those that are not among them are emptied first."""
        self.retired.extend(ear for kind, ear in self.ears.items() if kind not in ears)
        self.ears = ears
        # what a publisher sent before it could be heard is not lost
        self.first = False

    def listen_anew(self, ears: dict[Kind, Subscription]) -> None:
        """Go on with these subscriptions in place of those that were ended with what they held."""
        self.ears = ears
        self._renewed = True
        self.unsure |= not (self.countable and (self.sequence or self.first))

    def is_repeat(self, sent: int, sequence: int) -> bool:
        """Return whether another subscription has brought a message already; remember it."""
        mark = (sent, sequence)
        # who publishes latched messages sends them again to a subscription that is new
        if len(self.ears) + len(self.retired) < 2 and not self._renewed:
            self._seen = None
        elif self._seen is None:
            self._seen = set(self._marks)
        if self._seen is not None:
            if mark in self._seen:
                return True
            self._seen.add(mark)
            if len(self._marks) == self._marks.maxlen:
                self._seen.discard(self._marks[0])
        self._marks.append(mark)
        return False

    def count_gap(self, sequence: int) -> None:
        """Count what is missing before a message, if all come from one publisher."""
        lost = sequence - self.sequence - 1
        if self.countable and lost > 0 and (self.sequence or self.first):
            self.lost_on_the_way += lost
