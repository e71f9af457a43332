# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Nobody off this host gets in by default, tried from another one: a network namespace."""
import json
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys
from xml.etree import ElementTree

from carracing_dqn.bringup.environment import lay_out
from graph_probe import wait_for
from msgs_bridge.before_rclpy import before_rclpy
from msgs_bridge.errors import BridgeError
from msgs_bridge.host_only import (
    CLOSED, CLOSED_PROFILE, OPEN_PROFILE, PROFILE_VARIABLE, RANGE, SKIP_VARIABLE,
    stay_on_this_host,
)
from msgs_bridge.share import share_path
import pytest

ROOT = Path(__file__).resolve().parents[1]
HERE, THERE = '10.77.0.1', '10.77.0.2'
# what an outsider does: look for nodes and their services with every means that ROS has
OUTSIDER = """
import json, os, sys, time, rclpy
rclpy.init()
node = rclpy.create_node('outsider')
until = time.monotonic() + float(sys.argv[1])
names = set()
while time.monotonic() < until and len(names) < 1:
    rclpy.spin_once(node, timeout_sec=0.1)
    names = set(node.get_node_names()) - {'outsider'}
print(json.dumps(sorted(names)), flush=True)
os._exit(0)
"""
# what outsiders leave in shared memory goes with them
ON_A_HOST = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"'
# a node as every process of ours begins one
NODE = """
import time
from msgs_bridge.before_rclpy import before_rclpy
before_rclpy()
import rclpy
rclpy.init()
node = rclpy.create_node('one')
from std_msgs.msg import String
publisher = node.create_publisher(String, 'words', 1)
print('up', flush=True)
while True:
    publisher.publish(String(data='word'))
    time.sleep(0.05)
"""
LISTENER = """
import rclpy
from rclpy.wait_for_message import wait_for_message
from std_msgs.msg import String
rclpy.init()
print(wait_for_message(String, rclpy.create_node('other'), 'words', time_to_wait=30)[1].data)
rclpy.shutdown()
"""


def clean_environment(**changed):
    """Return the environment as a user has it, who has said nothing about DDS."""
    kept = {name: value for name, value in os.environ.items()
            if name not in (RANGE, PROFILE_VARIABLE, SKIP_VARIABLE, 'ROS_STATIC_PEERS')}
    return {**kept, **changed}


def ip(*words):
    return subprocess.run(['ip', *words], capture_output=True, text=True)


@pytest.fixture(scope='module')
def hosts():
    """Two network namespaces with a wire between them."""
    if os.geteuid() != 0 or not shutil.which('ip'):
        pytest.skip('needs root and iproute2 to make network namespaces')
    names = [f'host{os.getpid()}{side}' for side in 'ab']
    try:
        for name in names:
            if ip('netns', 'add', name).returncode:
                pytest.skip('network namespaces are not allowed here')
        wire = ip('link', 'add', 'wire', 'netns', names[0], 'type', 'veth',
                  'peer', 'name', 'wire', 'netns', names[1])
        if wire.returncode:
            pytest.skip(f'no pair of network devices to be had here: {wire.stderr.strip()}')
        for name, address in zip(names, (HERE, THERE)):
            for words in (['addr', 'add', f'{address}/24', 'dev', 'wire'],
                          ['link', 'set', 'wire', 'up'], ['link', 'set', 'lo', 'up'],
                          ['route', 'add', '224.0.0.0/4', 'dev', 'wire']):
                assert not ip('-n', name, *words).returncode, words
        yield names
    finally:
        for name in names:
            ip('netns', 'del', name)


def on(host, *command):
    return ['ip', 'netns', 'exec', host, 'sh', '-c', ON_A_HOST, 'sh', *command]


@pytest.mark.parametrize(('said', 'seen'), [
    ({}, []),
    ({RANGE: 'LOCALHOST', 'ROS_STATIC_PEERS': THERE}, []),
    ({RANGE: 'SUBNET'}, ['bag_recorder_node']),
], ids=['by default', 'static peers alone', 'opened'])
def test_an_outsider_sees_a_node_only_where_its_user_has_opened_it(hosts, said, seen, tmp_path):
    here, there = hosts
    node = subprocess.Popen(
        on(here, sys.executable, '-m', 'bags.recorder_node', '--ros-args', '-p',
           f'folder:={tmp_path / "bag"}'),
        stdout=subprocess.DEVNULL, env=clean_environment(**said))
    try:
        wait_for(lambda: 'python' in os.readlink(f'/proc/{node.pid}/exe'), 30, 'it starts there')
        same_host = ['nsenter', '-t', str(node.pid), '-m', '-n']
        assert look(same_host, 30, **{RANGE: 'LOCALHOST'}) == ['bag_recorder_node']
        outside = {RANGE: 'SUBNET', 'ROS_STATIC_PEERS': HERE}
        assert look(on(there), 30 if seen else 5, **outside) == seen
    finally:
        node.kill()
        node.wait()


def look(prefix, seconds, **environment):
    """Return the nodes that a process with rclpy and nothing of ours sees."""
    done = subprocess.run(
        [*prefix, sys.executable, '-c', OUTSIDER, str(seconds)], capture_output=True, text=True,
        timeout=120, env=clean_environment(**environment))
    return json.loads(done.stdout.splitlines()[-1])


def environment_after(monkeypatch, **given):
    for name in (RANGE, PROFILE_VARIABLE, SKIP_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    stay_on_this_host()
    return os.environ.get(RANGE), os.environ.get(PROFILE_VARIABLE)


def test_one_switch_opens_and_a_profile_of_the_users_own_stays(monkeypatch):
    profile, opened = (str(share_path(one)) for one in (CLOSED_PROFILE, OPEN_PROFILE))
    assert environment_after(monkeypatch) == (CLOSED, profile)
    assert os.environ[SKIP_VARIABLE] == '1'
    for closed in ('subnet', 'LOCALHOST', CLOSED, ''):
        assert environment_after(monkeypatch, **{RANGE: closed}) == (CLOSED, profile)
    for range_ in ('LOCALHOST', 'SUBNET'):
        environment_after(monkeypatch, ROS_LOCALHOST_ONLY='1', **{RANGE: range_})
        assert 'ROS_LOCALHOST_ONLY' not in os.environ
    assert environment_after(monkeypatch, **{RANGE: 'OFF'}) == ('OFF', profile)
    assert environment_after(monkeypatch, **{RANGE: 'SUBNET'}) == ('SUBNET', opened)
    assert SKIP_VARIABLE not in os.environ
    # a child of a closed process whose user has opened the range
    assert environment_after(
        monkeypatch, **{RANGE: 'SUBNET', PROFILE_VARIABLE: profile, SKIP_VARIABLE: '1'},
    ) == ('SUBNET', opened)
    assert SKIP_VARIABLE not in os.environ
    assert environment_after(monkeypatch, **{PROFILE_VARIABLE: opened}) == (CLOSED, profile)
    # the range of a closed shell does not open with a profile or a middleware that closes nothing
    for given, left in ((CLOSED, 'LOCALHOST'), ('LOCALHOST', 'LOCALHOST'), ('SUBNET', 'SUBNET')):
        own = {RANGE: given, PROFILE_VARIABLE: '/etc/own.xml'}
        assert environment_after(monkeypatch, **own) == (left, '/etc/own.xml')
        other = {RANGE: given, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}
        assert environment_after(monkeypatch, **other) == (left, None)
        monkeypatch.delenv('RMW_IMPLEMENTATION')
    assert environment_after(monkeypatch, RMW_IMPLEMENTATION='rmw_zenoh_cpp')[0] == 'LOCALHOST'
    for fast_dds in ('rmw_fastrtps_cpp', ''):
        monkeypatch.setenv('RMW_IMPLEMENTATION', fast_dds)
        assert environment_after(monkeypatch) == (CLOSED, profile)


def test_a_profile_of_ours_that_is_gone_is_replaced_by_the_present_one(monkeypatch, tmp_path):
    """A shell keeps the path of a checkout that was moved; without a profile Fast DDS opens."""
    moved = str(tmp_path / CLOSED_PROFILE)
    assert environment_after(monkeypatch, **{PROFILE_VARIABLE: moved}) == (
        CLOSED, str(share_path(CLOSED_PROFILE)))
    assert environment_after(monkeypatch, **{RANGE: 'SUBNET', PROFILE_VARIABLE: moved}) == (
        'SUBNET', str(share_path(OPEN_PROFILE)))


def places_of(process):
    """Return the addresses of a process's UDP sockets."""
    inodes = {os.readlink(one) for one in Path(f'/proc/{process.pid}/fd').iterdir()}
    rows = [row.split() for row in Path('/proc/net/udp').read_text().splitlines()[1:]]
    return {socket.inet_ntoa(int(row[1].split(':')[0], 16).to_bytes(4, sys.byteorder))
            for row in rows if f'socket:[{row[9]}]' in inodes}


@pytest.mark.parametrize('range_', ['LOCALHOST', 'SUBNET'])
def test_a_node_has_no_shared_memory_and_where_closed_no_other_address(range_):
    """A segment of Fast DDS is never whole again after a reader died: images are lost in it."""
    node = subprocess.Popen(
        [sys.executable, '-c', NODE], stdout=subprocess.PIPE, text=True,
        env=clean_environment(**{RANGE: range_}))
    try:
        assert node.stdout.readline()
        # nodes of others, whose transports are those of ROS
        for theirs in ({}, {RANGE: 'LOCALHOST'}):
            heard = subprocess.run([sys.executable, '-c', LISTENER], capture_output=True,
                                   text=True, timeout=60, env=clean_environment(**theirs))
            assert heard.stdout == 'word\n', (theirs, heard.stderr)
        assert '/dev/shm/fastrtps' not in Path(f'/proc/{node.pid}/maps').read_text()
        places = places_of(node)
        assert places == {'127.0.0.1'} if range_ == 'LOCALHOST' else '0.0.0.0' in places
    finally:
        node.kill()
        node.wait()


def test_publishers_look_as_often_for_what_has_not_arrived_however_open_the_graph():
    period = [ElementTree.parse(share_path(one)).findtext(
        './/{*}publisher[@is_default_profile="true"]/{*}times/{*}heartbeatPeriod/{*}nanosec')
        for one in (CLOSED_PROFILE, OPEN_PROFILE)]
    assert period[0] == period[1] == '200000000'


@pytest.mark.parametrize('content', [
    None, b'no profile', b'\xff\xfe', b'<launch><profiles/></launch>', 'fifo'])
def test_a_profile_that_cannot_be_read_opens_nothing(monkeypatch, tmp_path, content):
    own = tmp_path / 'own.xml'
    if content == 'fifo':
        os.mkfifo(own)
    elif content is not None:
        own.write_bytes(content)
    environment_after(monkeypatch, **{PROFILE_VARIABLE: str(own)})
    with pytest.raises(BridgeError, match=f'{PROFILE_VARIABLE} names no profile.*unset it'):
        before_rclpy()
    # who has opened the graph loses nothing by it
    monkeypatch.setenv(RANGE, 'SUBNET')
    before_rclpy()
    own.unlink(missing_ok=True)
    own.write_text(share_path(CLOSED_PROFILE).read_text())
    environment_after(monkeypatch, **{PROFILE_VARIABLE: str(own)})
    before_rclpy()


def test_the_setup_file_does_the_same_for_tools_that_are_not_ours(tmp_path):
    lay_out(tmp_path, ROOT)
    (tmp_path / 'bin').mkdir()
    (tmp_path / 'bin' / 'activate').write_text('')
    (tmp_path / 'bin' / 'python').write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (tmp_path / 'bin' / 'python').chmod(0o755)
    source = f'. {tmp_path}/setup.bash;'
    show = f'echo $AMENT_PREFIX_PATH ${RANGE} ${PROFILE_VARIABLE};'

    def say(script, **environment):
        return subprocess.run(
            ['bash', '-c', script], env={'PATH': os.environ['PATH'], **environment}, cwd=ROOT,
            capture_output=True, text=True, check=True).stdout.split()

    profile, opened = (
        str(tmp_path / 'share/carracing_dqn' / one) for one in (CLOSED_PROFILE, OPEN_PROFILE))
    assert say(source + show) == [str(tmp_path), CLOSED, profile]
    assert say(source + show, **{RANGE: 'SUBNET', 'AMENT_PREFIX_PATH': '/opt/ros'}) == [
        f'{tmp_path}:/opt/ros', 'SUBNET', opened]
    assert say(f'{source} export {RANGE}=SUBNET; {source} echo ${PROFILE_VARIABLE}') == [opened]


@pytest.mark.skipif(os.geteuid() != 0, reason='only root may make a network namespace')
def test_a_node_says_so_where_the_loopback_interface_is_down():
    done = subprocess.run(
        ['unshare', '-n', sys.executable, '-m', 'dqn_policy_node'], capture_output=True,
        text=True, timeout=60, env=clean_environment())
    if done.stderr.startswith('unshare'):
        pytest.skip(done.stderr)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and 'ip link set lo up' in done.stderr
