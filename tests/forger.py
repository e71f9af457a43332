# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Announces topics of hostile types over real DDS, as a participant that is no ROS node may."""
import ctypes
import sys
import time

import rclpy
from std_msgs.msg import String

# PACKAGE/msg/NAME on the wire: no package, no message, a module with side effects, no text
TYPES = (
    (b'std_msgs::msg', b'_bool'), (b'std_msgs::msg', b'Nothing'), (b'os::path', b'join'),
    (b'antigravity::msg', b'X'), (b'rclpy::node', b'Node'), (b'std_srvs::srv', b'SetBool'),
    (b'std_msgs::msg', b'[/red]\x1b[31m' + 200 * b'x'))
NO_TEXT = ((b'\xff\xfe::msg', b'\xff'),)


class Support(ctypes.Structure):
    """The head of rosidl_message_type_support_t."""

    _fields_ = [('identifier', ctypes.c_char_p),
                ('names', ctypes.POINTER(ctypes.c_char_p * 2))]


def main(topic: str, types: tuple) -> None:
    """Publish one topic a type until the process is ended."""
    get = ctypes.CDLL('libstd_msgs__rosidl_typesupport_fastrtps_c.so')[
        'rosidl_typesupport_fastrtps_c__get_message_type_support_handle__std_msgs__msg__String']
    get.restype = ctypes.POINTER(Support)
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node('forger', start_parameter_services=False)
    publishers = []
    for number, names in enumerate(types):
        get().contents.names.contents[:] = names
        publishers.append(node.create_publisher(
            String, topic if len(types) == 1 else f'{topic}{number}', 10))
    sys.stdout.write('announced\n')
    sys.stdout.flush()
    while True:
        for publisher in publishers:
            publisher.publish(String(data='boo'))
        time.sleep(0.05)


if __name__ == '__main__':
    main(sys.argv[1], NO_TEXT if 'no_text' in sys.argv else TYPES)
