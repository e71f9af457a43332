# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""When which message is due: pace, pause, step, clock, reading ahead; without ROS."""
import threading
import time

from bags.errors import BagError
from bags.lockstep import Comparison, MOST_WAITING
from bags.playback import LATE_KEPT, next_rate, Playback, RATES
from bags.read_ahead import BATCH_BYTES, ReadAhead, WAITING
from bags.messages import BagMessage
from bags.recording import Recording
from bags.writer import BagWriter
import pytest

MILLISECOND = 1_000_000


def messages(count, period=10 * MILLISECOND, start=10 ** 18):
    return [BagMessage('/x', start + number * period, 0, b'') for number in range(count)]


def in_thread(playback, items):
    thread = threading.Thread(target=playback.play, args=(items,), daemon=True)
    thread.start()
    return thread


def test_messages_are_published_when_they_are_due():
    times = []
    playback = Playback(lambda message: times.append(time.monotonic()))
    playback.play(messages(31))
    assert len(times) == playback.played == 31
    assert times[-1] - times[0] == pytest.approx(0.3, abs=0.05)
    middle, worst, most = playback.timing_error()
    assert 0 <= middle <= worst <= most
    # a busy machine may be late, but not by as much as the messages are apart
    assert middle < 0.005


def test_rate_changes_the_pace_and_zero_means_no_pace():
    for rate, seconds in ((4.0, 0.1), (0.0, 0.0)):
        playback = Playback(lambda message: None, rate=rate)
        began = time.monotonic()
        playback.play(messages(41))
        assert time.monotonic() - began == pytest.approx(seconds, abs=0.05)
        assert len(playback.late) == (41 if rate else 0)


def test_rate_can_change_while_playing():
    playback = Playback(lambda message: None, rate=0.1)
    thread = in_thread(playback, messages(100))
    time.sleep(0.15)
    before = playback.played
    assert before < 5
    playback.set_rate(100.0)
    thread.join(2)
    assert not thread.is_alive()
    assert playback.played == 100
    assert playback.timing_error()[1] < 0.05


def test_pause_and_step():
    seen = []
    playback = Playback(seen.append, rate=10.0, paused=True)
    thread = in_thread(playback, messages(20))
    time.sleep(0.05)
    assert seen == []
    for number in range(1, 4):
        assert playback.step()
        deadline = time.monotonic() + 1
        while len(seen) < number and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(0.02)
        assert len(seen) == number
    playback.pause(False)
    assert not playback.step()
    thread.join(2)
    assert seen == messages(20)
    # what waited during the pause is not late, it is due when playing goes on
    assert playback.timing_error()[2] < 0.05


def test_a_bag_that_is_held_back_stands_paused_or_not():
    seen = []
    playback = Playback(seen.append, rate=0.0, paused=True)
    playback.hold(True)
    thread = in_thread(playback, messages(20))
    assert playback.step()
    playback.pause(False)
    time.sleep(0.05)
    assert seen == []
    playback.hold(False)
    thread.join(2)
    assert seen == messages(20)


def test_a_wound_playback_says_where_to_go_on_paused_or_not():
    seen = []
    playback = Playback(seen.append, paused=True)
    thread = in_thread(playback, messages(20))
    playback.wind(7)
    thread.join(2)
    assert not thread.is_alive() and seen == []
    # the place is shown at once, and what is wound between two calls is not lost
    assert playback.now == 7 and playback.wound() == 7 and playback.wound() is None
    playback.wind(9)
    playback.play(messages(20))
    assert seen == [] and playback.wound() == 9
    playback.set_rate(0)
    playback.pause(False)
    playback.play(messages(20))
    assert len(seen) == 20 and playback.wound() is None


def test_the_next_rate_ends_at_the_last():
    assert [next_rate(rate, 1) for rate in (0.1, 0.7, 1.0, 20.0, 50.0)] == [
        0.25, 1.0, 2.0, 20.0, 50.0]
    assert [next_rate(rate, -1) for rate in (50.0, 1.0, 0.1)] == [20.0, 0.5, 0.1]
    # as fast as possible is above all of them
    assert next_rate(0, 1) == 0 and next_rate(0, -1) == RATES[-1]


def test_stop_ends_a_long_wait_at_once():
    playback = Playback(lambda message: None)
    thread = in_thread(playback, messages(2, period=3600 * 10 ** 9))
    time.sleep(0.05)
    playback.stop()
    thread.join(60)
    assert not thread.is_alive()
    assert playback.played == 1


def test_a_playback_says_when_the_next_message_is_due():
    playback = Playback(lambda message: None)
    thread = in_thread(playback, messages(2, period=10 ** 18))
    time.sleep(0.2)
    assert playback.played == 1
    assert playback.due - time.monotonic() == pytest.approx(10 ** 9, abs=10)
    playback.pause(True)
    time.sleep(0.1)
    assert playback.due is None
    playback.stop()
    thread.join(2)
    assert not thread.is_alive()


def test_a_clock_is_never_ahead_of_the_next_message_though_it_wakes_late():
    ticks = []
    playback = Playback(lambda message: None, publish_clock=ticks.append, clock_rate=1000.0)
    start = 10 ** 18
    thread = in_thread(playback, messages(2, period=100 * MILLISECOND, start=start))
    time.sleep(0.05)
    # as long as this is taken nobody wakes
    with playback._change:
        time.sleep(0.2)
    thread.join(2)
    assert not thread.is_alive()
    assert ticks == sorted(ticks)
    assert ticks[-1] <= start + 100 * MILLISECOND


def test_a_clock_that_hardly_ever_ticks_waits_no_longer_than_a_lock_can():
    ticks = []
    playback = Playback(lambda message: None, paused=True, clock_rate=1e-11,
                        publish_clock=ticks.append)
    thread = in_thread(playback, messages(3))
    playback.step()
    time.sleep(0.1)
    assert thread.is_alive() and playback.played == 1
    playback.stop()
    thread.join(2)
    assert not thread.is_alive()


def test_clock_ticks_between_messages_and_stands_while_paused():
    ticks = []
    playback = Playback(lambda message: None, rate=2.0, clock_rate=100.0,
                        publish_clock=ticks.append)
    items = messages(3, period=200 * MILLISECOND)
    thread = in_thread(playback, items)
    thread.join(2)
    assert len(ticks) == pytest.approx(20, abs=6)
    assert ticks == sorted(ticks)
    assert items[0].log_time <= ticks[0]
    assert ticks[-1] <= items[-1].log_time + 20 * MILLISECOND
    steps = [(later - earlier) / MILLISECOND for earlier, later in zip(ticks, ticks[1:])]
    assert sorted(steps)[len(steps) // 2] == pytest.approx(20, abs=8)
    playback.now = 77
    playback.pause(True)
    ticks.clear()
    thread = in_thread(playback, items)
    time.sleep(0.1)
    playback.stop()
    thread.join(1)
    assert len(ticks) > 3
    assert set(ticks) == {77}


def test_reading_ahead_gives_everything_in_order_and_then_the_error():
    def source():
        yield from messages(1000)
        raise BagError('the chunk is damaged')
    seen = []
    ahead = ReadAhead(source())
    with pytest.raises(BagError, match='damaged'):
        for message in ahead:
            seen.append(message)
    assert seen == messages(1000)
    ahead.close()


def test_reading_ahead_is_bounded_and_ends_when_nobody_wants_more():
    read = []

    def source():
        for message in messages(100_000):
            read.append(1)
            yield message
    ahead = ReadAhead(source())
    iterator = iter(ahead)
    next(iterator)
    time.sleep(0.3)
    assert len(read) <= 5 * 256
    ahead.close()
    assert len(read) <= 5 * 256


class SlowWriter(BagWriter):
    """A disk that takes its time."""

    def write(self, *arguments):
        time.sleep(0.01)
        super().write(*arguments)


def test_a_full_cache_is_said_and_nothing_is_dropped(tmp_path):
    recording = Recording(SlowWriter(tmp_path / 'bag'), cache_bytes=5000)
    topic = recording.add_topic('/x', 'std_msgs/msg/Float32', [])
    for number in range(20):
        recording.put([(number, number, topic, bytes(1000))])
    assert recording.room <= 0
    assert recording.peak_bytes >= 5000
    recording.close()
    assert recording.room == 5000
    assert recording.writer.message_count == 20
    assert recording.lost == 0


def test_what_is_kept_of_how_late_messages_were_is_bounded():
    playback = Playback(lambda message: None, rate=1e4)
    playback.play(messages(LATE_KEPT + 1000, period=1))
    assert playback.played == LATE_KEPT + 1000
    assert len(playback.late) == LATE_KEPT
    assert playback.timing_error()[2] >= max(playback.late)


def test_large_messages_are_read_ahead_one_by_one():
    read = []

    def source():
        for number in range(100):
            read.append(number)
            yield BagMessage('/x', number, 0, bytes(BATCH_BYTES))
    ahead = ReadAhead(source())
    next(iter(ahead))
    time.sleep(0.3)
    assert len(read) <= WAITING + 2, len(read)
    ahead.close()


def test_q_values_are_compared_by_stamp_in_whatever_order_they_come():
    comparison = Comparison()
    assert comparison.text() == ''
    comparison.recorded(1, {'a': 1.0, 'b': 2.0, 'chosen': 1, 'weights_version': 3})
    comparison.answered(1, {'a': 1.5, 'b': 2.0, 'chosen': 1, 'weights_version': 9})
    comparison.answered(2, {'a': 1.0, 'chosen': 0})
    comparison.recorded(2, {'a': 1.0, 'c': 7.0, 'chosen': 1})
    assert comparison.text() == (
        '2 q_values compared: the same action in 50.0%, Q-values differ by up to 0.5')
    # what one side lacks is not kept for ever
    for stamp in range(10, 10 + 3 * MOST_WAITING):
        comparison.recorded(stamp, {'a': 1.0})
    comparison.answered(10, {'a': 1.0})
    assert comparison.compared == 2
