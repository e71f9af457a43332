# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that are wrong: random bytes, random values of the right type, and well-formed lies."""
from __future__ import annotations

from array import array
from collections.abc import Callable
from random import Random
import re
import struct

from msgs_bridge.message_types import message_class
from rclpy.serialization import deserialize_message, serialize_message

ODD_SECONDS = (0, 1, -1, -2**31, 2**31 - 1, 1_000_000)
ODD_NANOSECONDS = (0, 1, 999_999_999, 10**9, 2**32 - 1)
ODD_FLOATS = (float('nan'), float('inf'), float('-inf'), 1e308, -1e308, 1e30, -1.0, 5e-324, 0.5,
              1e12, 2.0**53)
ODD_TEXTS = ('', '[/x]', '[red]', '\x1b[2J\x1b]52;c;YQ==\x07', 'x' * 100_000, 'a\nb', 'ä€😀',
             '../../etc/passwd', 'reward', 'NaN', '{}', '%s%n')
ENCODINGS = ('', 'mono16', '8UC3', 'bayer_rggb8', 'rgb16', 'RGB8', 'rgb8 ', 'yuv422', '[/x]')
# small-endian CDR, the form in which ROS sends
CDR = b'\x00\x01\x00\x00'
# what one message may take, so that the machine and not only the product outlives it
LONGEST = 4 << 20

INTEGERS = {'int8': 7, 'int16': 15, 'int32': 31, 'int64': 63,
            'uint8': 8, 'uint16': 16, 'uint32': 32, 'uint64': 64}


def random_value(kind: str, random: Random) -> object:
    """Return a random value of an IDL type as rclpy names it, for example sequence<double>."""
    many = re.fullmatch(r'sequence<([^,>]+)(?:, (\d+))?>|(.+)\[(\d+)\]', kind)
    if many:
        element = many[1] or many[3]
        count = int(many[4]) if many[4] else random.choice((0, 1, 3, 50))
        values = [random_value(element, random) for _ in range(count)]
        return bytes(values) if element == 'octet' else values
    if kind in INTEGERS:
        bits = INTEGERS[kind]
        low = 0 if kind.startswith('u') else -2**bits
        return random.choice((low, 0, 1, 2**bits - 1, random.randrange(low, 2**bits)))
    if kind == 'boolean':
        return random.random() < 0.5
    if kind in ('octet', 'byte'):
        return bytes([random.randrange(256)])
    if kind == 'float':
        return random.choice((float('nan'), float('inf'), -1.0, random.uniform(-3e38, 3e38)))
    if kind == 'double':
        return random.choice((*ODD_FLOATS, random.uniform(-1e9, 1e9)))
    if kind.startswith('string') or kind.startswith('wstring'):
        return random.choice(ODD_TEXTS)
    package, name = kind.split('/')
    return random_message(f'{package}/msg/{name}', random)


def random_message(type_name: str, random: Random) -> object:
    """Return a message of a type with random values in every field."""
    message = message_class(type_name)()
    for field, kind in message.get_fields_and_field_types().items():
        setattr(message, field, random_value(kind, random))
    return message


def garbage(type_name: str, data: bytes, random: Random) -> bytes:
    """Return serialised rubbish in place of a message: bytes or values that are random."""
    choice = random.randrange(5)
    if choice == 0:
        return CDR + random.randbytes(random.choice((0, 1, 7, 64, 4096)))
    if choice == 1:
        return data[:random.randrange(4, len(data) + 1)]
    if choice == 2:
        changed = bytearray(data)
        for _ in range(random.choice((1, 8, 64))):
            changed[random.randrange(4, len(data))] = random.randrange(256)
        return bytes(changed)
    if choice == 3:
        # lengths of sequences and texts stand near the front
        changed = bytearray(data)
        position = random.randrange(4, min(len(data), 64))
        changed[position:position + 4] = struct.pack('<I', random.choice(
            (2**32 - 1, 2**31, 2**20, 0, 1)))
        return bytes(changed)
    return serialize_message(random_message(type_name, random))


def wrong(type_name: str, data: bytes, random: Random) -> bytes:
    """Return a well-formed message that lies: a true one with something odd in it."""
    message = deserialize_message(data, message_class(type_name))
    changes = list(LIES.get(type_name, ()))
    if hasattr(message, 'header'):
        changes += [odd_stamp, odd_frame]
    random.choice(changes or [lambda *_: None])(message, random)
    lie = serialize_message(message)
    return lie if len(lie) <= LONGEST else data


def odd_stamp(message: object, random: Random) -> None:
    """Give a message a stamp far away, near by, or none that there is."""
    stamp = message.header.stamp
    if random.random() < 0.3:
        stamp.sec = max(-2**31, min(2**31 - 1, stamp.sec + random.choice((-5, -1, 1, 60))))
    else:
        stamp.sec = random.choice(ODD_SECONDS)
        stamp.nanosec = random.choice(ODD_NANOSECONDS)


def odd_frame(message: object, random: Random) -> None:
    """Give a message a frame_id that nobody would choose."""
    message.header.frame_id = random.choice(ODD_TEXTS)


def odd_image(message: object, random: Random) -> None:
    """Let an image claim a size, an encoding or a length that it has not."""
    choice = random.randrange(7)
    if choice == 0:
        message.encoding = random.choice((*ENCODINGS, *ODD_TEXTS))
    elif choice == 1:
        message.height = random.choice((0, 1, 4097, 2**32 - 1))
    elif choice == 2:
        message.width = random.choice((0, 1, 4097, 2**32 - 1))
    elif choice == 3:
        message.step = random.choice((0, 1, 2**32 - 1))
    elif choice == 4:
        message.data = array('B', random.randbytes(random.choice((0, 1, 1000, 100_000))))
    elif choice == 5:
        side = random.choice((1, 48, 200, 1000))
        message.height = message.width = side
        message.step, message.encoding = 3 * side, 'rgb8'
        message.data = array('B', bytes(3 * side * side))
    else:
        message.is_bigendian = 255
        message.data = array('B', random.randbytes(len(message.data)))


def odd_bundle(message: object, random: Random) -> None:
    """Let a bundle of named values lack, repeat, misname or overstate something."""
    choice = random.randrange(7)
    names, values = list(message.name), list(message.position)
    count = min(len(names), len(values))
    index = random.randrange(count) if count else 0
    if choice == 0 and count:
        del names[index], values[index]
    elif choice == 1 and count:
        names.append(names[index])
        values.append(values[index])
    elif choice == 2 and count:
        names[index] = random.choice(ODD_TEXTS)
    elif choice == 3:
        values.append(0.0)
    elif choice == 4:
        names += [f'odd{number}' for number in range(1000)]
        values += [0.0] * 1000
    elif choice == 5:
        names, values = [], []
    elif count:
        values[index] = random.choice(ODD_FLOATS)
    message.name, message.position = names, values


def odd_twist(message: object, random: Random) -> None:
    """Command something that no car can do."""
    twist = getattr(message, 'twist', message)
    axis = random.choice((twist.linear, twist.angular))
    setattr(axis, random.choice('xyz'), random.choice(ODD_FLOATS))


def odd_bytes(message: object, random: Random) -> None:
    """Cut, flip or replace the file image in a byte array."""
    data = bytearray(message.data)
    choice = random.randrange(4)
    if choice == 0:
        data = data[:random.randrange(len(data) + 1)]
    elif choice == 1 and data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)
    elif choice == 2 and len(data) > 8:
        # a safetensors file begins with the length of its header
        data[:8] = struct.pack('<Q', random.choice((0, 2**63, 2**64 - 1, len(data))))
    else:
        data = bytearray(random.randbytes(random.choice((0, 8, 100_000))))
    message.data = array('B', bytes(data))


def odd_clock(message: object, random: Random) -> None:
    """Set the time to what it cannot be."""
    message.clock.sec = random.choice(ODD_SECONDS)
    message.clock.nanosec = random.choice(ODD_NANOSECONDS)


def odd_health(message: object, random: Random) -> None:
    """Let the diagnostics speak in markup, in escapes, at length, or not at all."""
    for status in message.status:
        status.message = random.choice(ODD_TEXTS)
        status.level = bytes([random.randrange(256)])
        if random.random() < 0.5:
            status.name = random.choice((status.name, *ODD_TEXTS))
        for pair in status.values:
            pair.value = random.choice(ODD_TEXTS)
    if random.random() < 0.2:
        message.status = []


def odd_number(message: object, random: Random) -> None:
    """Publish a number that is none."""
    message.data = random.choice((float('nan'), float('inf'), -1e30))


LIES: dict[str, tuple[Callable[[object, Random], None], ...]] = {
    'sensor_msgs/msg/Image': (odd_image, odd_image, odd_image),
    'sensor_msgs/msg/JointState': (odd_bundle, odd_bundle, odd_bundle),
    'geometry_msgs/msg/TwistStamped': (odd_twist,),
    'std_msgs/msg/UInt8MultiArray': (odd_bytes,),
    'rosgraph_msgs/msg/Clock': (odd_clock,),
    'diagnostic_msgs/msg/DiagnosticArray': (odd_health, odd_health),
    'std_msgs/msg/Float32': (odd_number,),
}
"""Type name -> what may be done to a message of it, repeated by weight."""
