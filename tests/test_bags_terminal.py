# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder and player at a real terminal: what they show, keys, and the terminal given back."""
import signal
import subprocess
import sys
import time

from bag_cases import record_drive
from bags.live_line import clock_text
from bags.recorder_terminal import recorded_text, waits_for
from carracing_dqn.bringup.processes import node_command
import pytest
from terminal_probe import WIDTH


def test_times_and_sizes_are_short():
    assert [clock_text(seconds) for seconds in (-1, 0.04, 59.96, 61.25, 3599.96, 7325.5)] == [
        '0:00.0', '0:00.0', '1:00.0', '1:01.2', '1:00:00.0', '2:02:05.5']
    assert recorded_text(61, 1200, 7, 2_500_000, 0) == (
        '1:01.0, 1200 messages of 7 topics, 2.5 MB, none lost')


@pytest.mark.parametrize(('wanted', 'came', 'published', 'told'), [
    (None, ['/rosout'], ['/rosout', '/diagnostics'], 'nobody publishes anything on domain 7'),
    (None, ['/rosout'], ['/rosout', '/image_raw'], 'the first message of /image_raw'),
    (None, ['/rosout', '/odom'], ['/rosout'], ''),
    ({'/a', '/b'}, ['/a'], ['/a'], 'waits for /b: nobody publishes that on domain 7'),
    ({'/a', '/b'}, ['/a'], ['/a', '/b'], 'waits for the first message of /b'),
    ({'/a'}, ['/a'], [], ''),
    ({f'/{number}' for number in range(9)}, [], [], '/4 and 4 more: nobody'),
])
def test_a_recorder_says_what_it_waits_for(wanted, came, published, told):
    text = waits_for(wanted, came, published, '7')
    assert told in text and (told or not text)


def test_a_bag_is_paused_wound_and_stepped_by_keys(terminal, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=1000)
    player = terminal([
        sys.executable, '-m', 'carracing_dqn.bringup', 'bag', 'play', str(bag), '--prefix',
        '/keys', '--wait-for-subscribers', '0.5'])
    lines = r'(\d+:\d\d\.\d) of \d+:\d\d\.\d, '
    player.until(lines + '1x')
    player.type(b'--')
    player.until(lines + r'0\.25x')
    player.type(b' ')
    place = player.until(lines + r'paused \| space pause').group(1)
    time.sleep(0.5)
    assert player.until(lines + 'paused').group(1) == place
    player.type(b'\x1b[D')
    assert player.until(lines + 'paused').group(1) == '0:00.0'
    player.type(b'ss ' + 6 * b'\x1b[C')
    # beyond the end it ends
    assert player.process.wait(20) == 0
    assert player.until(r'(\d+) messages played')
    assert player.given_back


def test_a_player_that_is_quit_gives_the_terminal_back(terminal, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=1, decisions=1000)
    player = terminal(node_command(
        'bags.player_node', {'bag': str(bag), 'prefix': '/quit', 'rate': 0.1}, 'quit'))
    player.until('waiting for subscribers')
    assert not player.given_back
    player.type(b'q')
    assert player.process.wait(30) == 0 and player.given_back


def test_what_is_done_with_a_long_bag_is_shown_and_leaves_an_empty_line(terminal, tmp_path):
    bag = record_drive(tmp_path / 'bag', episodes=2, decisions=1000)
    command = [sys.executable, '-m', 'carracing_dqn.bringup', 'bag', 'verify', str(bag)]
    verify = terminal(command)
    verify.until('checking files and transitions')
    verify.until(r'driving again: \d+%')
    said = verify.until(r'\x1b\[K([^\r]*)\r\n', 60).group(1)
    assert said.startswith('transitions: ')
    assert verify.process.wait(20) == 0
    # and nothing but the result where nobody looks
    piped = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert piped.stderr == '' and piped.stdout.startswith('transitions: ')


def test_what_a_recorder_has_stands_in_one_line(terminal, tmp_path):
    recorder = terminal(node_command(
        'bags.recorder_node', {'folder': str(tmp_path / 'bag'), 'topics': 'none_there'}, 'line'))
    line = recorder.until(r'waits for /line/none_there: nobody publishes that[^\r]*\x1b\[K')
    assert len(line.group()) < WIDTH
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.process.wait(30) == 0
    assert recorder.until('0 messages in ')
