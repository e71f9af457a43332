# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A name from outside never chooses what is imported."""
import subprocess
import sys

from hypothesis import given, strategies
from msgs_bridge.errors import MessageError
from msgs_bridge.message_types import message_class
from msgs_bridge.topics import TOPICS
import pytest
from sensor_msgs.msg import Image


def test_the_types_of_the_contract_are_found():
    assert message_class('sensor_msgs/msg/Image') is Image
    for topic in TOPICS:
        assert message_class(topic.type_name).__name__ == topic.type_name.split('/')[-1]


@pytest.mark.parametrize('name', [
    '', 'a', 'a/b', 'a/b/c/d', 'std_msgs/msg/_bool', 'std_msgs/msg/Nothing', 'os/path/join',
    'antigravity/msg/Y', 'rclpy/node/Node', 'std_srvs/srv/SetBool', '../std_msgs/msg/Bool',
    'std_msgs/msg/../msg/Bool', 'std_msgs/msg/Bool\n', '\x1b[31m/msg/X', 'x' * 10**6,
])
def test_any_other_name_is_not_installed(name):
    with pytest.raises(MessageError, match='is not installed here') as raised:
        message_class(name)
    assert len(str(raised.value)) < 400 and '\x1b' not in str(raised.value)


@given(strategies.text())
def test_no_text_raises_anything_else(name):
    with pytest.raises(MessageError):
        message_class(name)


def test_a_module_of_the_right_name_is_not_imported(tmp_path):
    (tmp_path / 'planted').mkdir()
    (tmp_path / 'planted' / 'msg.py').write_text('raise SystemExit(66)')
    code = ("from msgs_bridge.message_types import message_class\n"
            "try: message_class('planted/msg/Type')\nexcept ValueError: print('refused')")
    done = subprocess.run(
        [sys.executable, '-c', f'import sys; sys.path.append({str(tmp_path)!r})\n{code}'],
        capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, 'refused\n')
