# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Every fault that is tried: what, where, and what is expected. Adding one is adding a row."""
from __future__ import annotations

import dataclasses

YES, NO, EITHER = True, False, None


@dataclasses.dataclass(frozen=True)
class MessageCase:
    """
    A fault of `relay.KINDS` on a topic.

    Attributes:
        kind, topic: what and where.
        told: whether a node's diagnostics must rise above OK while it lasts, or must not.
        drives: whether the car must go on while it lasts.
        weight: how often it is drawn beside the others.
    """

    kind: str
    topic: str
    told: bool | None = EITHER
    drives: bool | None = EITHER
    weight: float = 1.0


@dataclasses.dataclass(frozen=True)
class ProcessCase:
    """
    A fault of `process_faults.FAULTS` of a node that runs.

    Attributes:
        fault, node: what and where.
        ends: whether the node ends by it and is started again, or must outlive it.
        told: as above.
        weight: as above.
    """

    fault: str
    node: str
    ends: bool | None = YES
    told: bool | None = EITHER
    weight: float = 1.0


def _messages(topic: str, drives: bool | None, told: dict[str, bool | None],
              weight: float) -> list[MessageCase]:
    kinds = ('off', 'stuck', 'garbage', 'wrong', 'slow', 'delayed', 'duplicated', 'reordered',
             'intermittent', 'flooding')
    return [MessageCase(kind, topic, told.get(kind, EITHER), drives, weight) for kind in kinds]


REFUSED = {'garbage': YES, 'wrong': YES}

MESSAGES = [
    # the loop of the drive: who misses an image or a twist stands and says so
    *_messages('image_raw', EITHER, {**REFUSED, 'off': YES, 'stuck': YES}, 3),
    *_messages('cmd_vel', EITHER, {**REFUSED, 'off': YES, 'stuck': YES}, 3),
    # only learning hangs on these
    *_messages('step', YES, {**REFUSED, 'off': YES, 'stuck': YES}, 3),
    # of depth 1: a good one may take the place of a bad one before anybody has seen that
    *_messages('weights', YES, {}, 2),
    *_messages('validation', YES, {}, 1),
    # nobody acts on these; they are shown and recorded
    *_messages('episode', YES, {}, 0.5),
    *_messages('q_values', YES, {}, 0.5),
    *_messages('reward', YES, {}, 0.5),
    *_messages('/clock', YES, {}, 0.5),
    *_messages('/diagnostics', YES, {}, 0.5),
]

NODES = ('simulator', 'policy', 'trainer', 'recorder', 'validator')

PROCESSES = [
    *[ProcessCase(fault, node) for node in NODES
      for fault in ('kill', 'terminate', 'hang up', 'interrupt')],
    *[ProcessCase('stop and continue', node, NO) for node in NODES],
    *[ProcessCase('few descriptors', node, NO) for node in NODES if node != 'trainer'],
    # who cannot write a checkpoint any more says so and stops, rather than to learn in vain
    ProcessCase('few descriptors', 'trainer', EITHER, YES),
    ProcessCase('out of disk', 'recorder', YES),
    ProcessCase('out of disk', 'trainer', EITHER, YES),
    ProcessCase('out of disk', 'simulator', NO),
]


@dataclasses.dataclass(frozen=True)
class FileCase:
    """
    A fault of `file_faults` of a file; the commands that read it must say what is wrong.

    Attributes:
        fault, file: what and where.
        weight: as above.
    """

    fault: str
    file: str
    weight: float = 1.0


FILES = [
    FileCase(fault, file, weight)
    for file, weight in (
        ('bag', 3), ('bag metadata', 1), ('checkpoint', 3), ('weights', 1),
        ('model description', 1), ('preset', 1), ('run config', 1), ('run record', 0.5),
        ('episodes table', 0.5))
    for fault in ('cut', 'flip', 'splice', 'swap', 'lie')]


@dataclasses.dataclass(frozen=True)
class CommandCase:
    """
    A fault of a whole command.

    Attributes:
        fault: signal, limit, removed folder, or kind of message from a stranger.
        command: run or train.
        part: node that the signal is sent to, topic of the stranger, or 'starting'.
        codes: exit codes that are right.
        weight: as above.
    """

    fault: str
    command: str
    part: str = ''
    codes: tuple[int, ...] = (2,)
    weight: float = 1.0


COMMANDS = [
    *[CommandCase(fault, command, part, codes)
      for command in ('run', 'train') for part in ('', 'starting')
      for fault, codes in (('kill', (-9,)), ('terminate', (130, 143, -15)),
                           ('hang up', (129, 130, -1)), ('interrupt', (130, -2)))],
    *[CommandCase(fault, command, node)
      for command, nodes in (('run', ('simulator', 'policy', 'recorder')),
                             ('train', ('simulator', 'policy', 'trainer', 'recorder')))
      for node in nodes for fault in ('kill', 'terminate')],
    *[CommandCase('folder removed', command, weight=2) for command in ('run', 'train')],
    *[CommandCase('few descriptors', command, codes=(0, 2, 130)) for command in ('run', 'train')],
    *[CommandCase('out of disk', command, codes=(0, 2, 130)) for command in ('run', 'train')],
    # a library that has no memory ends as it likes, but it ends
    *[CommandCase('little memory', command, codes=(0, 1, 2, 130), weight=0.5)
      for command in ('run', 'train')],
    *[CommandCase(kind, command, topic, (0, 130) if command == 'train' else (0,))
      for command, names in (('run', ('episode', '/diagnostics', 'image_raw', 'cmd_vel')),
                             ('train', ('validation', '/diagnostics', 'step', 'weights')))
      for topic in names for kind in ('garbage', 'wrong')],
]
