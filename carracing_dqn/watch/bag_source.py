# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as a source of what is watched: played, paused, stepped and wound, without ROS."""
from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import threading
from typing import Any

from bags.messages import BagMessage, BagTopic
from bags.playback import Playback
from bags.reader import BagReader
from carracing_dqn.watch.car import IMAGE_TYPES
from carracing_dqn.watch.commands import BAG_COMMANDS
from carracing_dqn.watch.graph_parts import End, TopicEnds
from carracing_dqn.watch.state import cars_first, MAX_TOPICS, WatchState
from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain
from msgs_bridge.stamps import NANOSECONDS

LOOK_SECONDS = 0.1


class BagSource:
    """
    Plays a bag into a `WatchState`.

    Attributes:
        state: what is known.
        commands: names of what can be done.
    """

    commands = BAG_COMMANDS

    def __init__(self, path: Path | str, *, paused: bool = False) -> None:
        """
        Open a bag and begin to play it.

        Raises:
            BagError: it is not there, not a bag, or damaged.
        """
        self._reader = BagReader(path)
        self.state = WatchState(f'bag {plain(Path(path).name)}')
        topics = self._reader.topics
        names = cars_first({name: (topic.type_name,) for name, topic in topics.items()})
        self._ends = {name: _ends(topics[name]) for name in names[:MAX_TOPICS]}
        self._images = {name for name, ends in self._ends.items()
                        if ends.type_name in IMAGE_TYPES}
        self._lock = threading.Lock()
        self._rate, self._paused = 1.0, paused
        self._begin_at = self._reader.start_time
        # stepping goes on until an image has come and the next one waits
        self._stepping = paused
        self._image_came = self._image_waits = False
        self._wound = self._back = self._ended = False
        self._wake = threading.Event()
        self._closing = threading.Event()
        self._playback = self._new_playback()
        self._threads = [threading.Thread(target=target, name=name, daemon=True)
                         for target, name in ((self._play, 'bag'), (self._look, 'look'))]
        for thread in self._threads:
            thread.start()

    def now(self) -> float:
        """Return the place in the bag, seconds from its start."""
        return max(0, self._playback.now - self._reader.start_time) / NANOSECONDS

    def act(self, name: str, value: Any = None, namespace: str | None = None) -> None:
        """
        Pause, step by an image, seek (seconds), skip (seconds from here), or set the rate.

        Raises:
            BridgeError: there is no such command, or the value is none for it.
        """
        BAG_COMMANDS.check(name, value)
        if name == 'pause':
            self._paused = value
            self._playback.pause(value)
            if self._ended and not value:
                # once more
                self._wind(0.0)
            self.state.say('paused' if value else 'playing')
        elif name == 'step':
            self._paused = self._stepping = True
            self._playback.pause(True)
            self._image_came = self._image_waits
            self._playback.step()
        elif name == 'rate':
            self._rate = float(value)
            self._playback.set_rate(self._rate)
            self.state.say(f'{value:g} times as fast as recorded')
        else:
            self._wind(value if name == 'seek' else self.now() + value)

    def close(self) -> None:
        """End, and close the bag."""
        self._closing.set()
        self._wake.set()
        self._playback.stop()
        for thread in self._threads:
            thread.join(timeout=2.0)
        self._reader.close()

    def _wind(self, seconds: float) -> None:
        """Go on from another place; paused, to the next image there."""
        reader = self._reader
        place = reader.start_time + round(max(0.0, seconds) * NANOSECONDS)
        with self._lock:
            self._begin_at = min(place, reader.end_time)
            self._back = self._back or self._begin_at < self._playback.now
            self._stepping = self._wound = True
            self._image_came = False
        self.state.say('')
        self._playback.stop()
        self._wake.set()

    def _new_playback(self) -> Playback:
        playback = Playback(self._take, rate=self._rate, paused=self._paused)
        playback.now = self._begin_at
        return playback

    def _play(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._wake.clear()
                self._wound = False
                self._playback = self._new_playback()
                start, back, self._back = self._begin_at, self._back, False
            self.state.forget(everything=back)
            self.state.see_graph((), self._ends, self.now())
            why = 'the end of the bag'
            try:
                self._playback.play(self._messages(start))
            except Exception as error:
                # of a damaged file, or of one that cannot be read any more
                why = str(error) if isinstance(error, BridgeError) else repr(error)
            if not self._wound and not self._closing.is_set():
                self._paused = self._ended = True
                self.state.say(why)
                self._wake.wait()
                self._ended = False

    def _messages(self, start: int) -> Iterator[BagMessage]:
        """Yield what is to be played, and let it through as far as a step goes."""
        for message in self._reader.messages(list(self._ends), start):
            self._image_waits = message.topic in self._images or not self._images
            if self._paused and self._stepping:
                if self._image_waits and self._image_came:
                    self._stepping = False
                else:
                    self._image_came |= self._image_waits
                    self._playback.step()
            yield message

    def _take(self, message: BagMessage) -> None:
        self.state.take(message.topic, self._ends[message.topic].type_name, bytes(message.data),
                        self.now())

    def _look(self) -> None:
        duration = (self._reader.end_time - self._reader.start_time) / NANOSECONDS
        while not self._closing.wait(LOOK_SECONDS):
            now = self.now()
            self.state.playing = {
                'position': round(now, 2), 'duration': round(duration, 2),
                'paused': self._paused, 'rate': self._rate}
            self.state.look(now)


def _ends(topic: BagTopic) -> TopicEnds:
    """Return a topic of a bag as if the bag published it, once with each QoS."""
    type_name = plain(topic.type_name)
    ends = [End('bag', type_name, f'{one["reliability"]}, {one["durability"]}'.replace('_', ' '),
                one['reliability'] != 'best_effort') for one in topic.qos]
    return TopicEnds(type_name, list(dict.fromkeys(ends)) or [
        End('bag', type_name, 'QoS unknown')])
