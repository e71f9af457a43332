# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are damaged or lie, and the commands that read them."""
from __future__ import annotations

from collections.abc import Callable
import contextlib
import json
import math
import os
from pathlib import Path
from random import Random
import re
import shutil

from bags.reader import BagReader
from bags.writer import BagWriter
from faults.command_process import run_command
from faults.message_faults import garbage, ODD_TEXTS, wrong
from faults.outcome import Outcome
from faults.running_graph import PRESET
from faults.tables import FileCase
import yaml

ODD_VALUES = (None, True, -1, 0, 1e308, 10**30, math.nan, math.inf, '', 'x' * 100_000, '[/x]',
              '\x1b[2J', [], {}, [[]], {'a': {'b': []}}, '../../x', '/dev/zero')


def cut(data: bytes, random: Random) -> bytes:
    """Lose the end."""
    return data[:random.randrange(len(data))]


def flip(data: bytes, random: Random) -> bytes:
    """Change one bit."""
    changed = bytearray(data)
    changed[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(changed)


def splice(data: bytes, random: Random) -> bytes:
    """Delete, insert, repeat or zero a stretch."""
    begin = random.randrange(len(data))
    end = min(len(data), begin + random.choice((1, 2, 16, 1000, 100_000)))
    middle = random.choice((
        b'', bytes(end - begin), data[begin:end] * 2,
        random.randbytes(end - begin) + data[begin:end]))
    return data[:begin] + middle + data[end:]


COMMAND_SECONDS = 120.0

DAMAGE = {'cut': cut, 'flip': flip, 'splice': splice}


def swap(path: Path, random: Random) -> None:
    """Put something else in the place of a file."""
    choice = random.randrange(6)
    siblings = [other for other in sorted(path.parent.iterdir())
                if other.is_file() and other != path]
    data = random.choice(siblings).read_bytes() if siblings else b''
    path.unlink()
    if choice == 0:
        os.mkfifo(path)
    elif choice == 1:
        path.mkdir()
    elif choice == 2:
        path.symlink_to('/dev/zero')
    elif choice == 3:
        path.write_bytes(b'')
    elif choice == 4:
        path.write_bytes(data)
    # else it is missing


def lie(path: Path, random: Random) -> None:
    """Keep the form of a file and put something odd into it."""
    if path.suffix == '.mcap':
        _lie_in_bag(path, random)
    elif path.suffix == '.safetensors':
        _lie_in_header(path, random)
    elif path.suffix == '.csv':
        text = path.read_text()
        path.write_text(re.sub(r'\d+', lambda found: random.choice(
            (found[0], found[0], 'nan', '-1', '', '1e999', '[/x]')), text))
    elif path.suffix == '.json':
        values = json.loads(path.read_text())
        _lie_in(values, random)
        path.write_text(json.dumps(values))
    else:
        values = yaml.safe_load(path.read_text())
        _lie_in(values, random)
        path.write_text(yaml.safe_dump(values))


def _lie_in(values: object, random: Random) -> None:
    """Change one value, however deep; texts that are JSON are changed inside."""
    while True:
        keys = list(values) if isinstance(values, dict) else list(range(len(values)))
        if not keys:
            return
        key = random.choice(keys)
        inner = values[key]
        if isinstance(inner, (dict, list)) and inner and random.random() < 0.8:
            values = inner
            continue
        if isinstance(inner, str) and inner.startswith('{') and random.random() < 0.9:
            with contextlib.suppress(ValueError):
                nested = json.loads(inner)
                _lie_in(nested, random)
                values[key] = json.dumps(nested)
                return
        if isinstance(values, dict) and random.random() < 0.2:
            del values[key]
        else:
            values[key] = random.choice((*ODD_VALUES, *ODD_TEXTS))
        return


def _lie_in_header(path: Path, random: Random) -> None:
    data = path.read_bytes()
    length = int.from_bytes(data[:8], 'little')
    header = json.loads(data[8:8 + length])
    told = header.get('__metadata__')
    # most of a header are tensors, most of what is believed stands here
    _lie_in(told if told and random.random() < 0.8 else header, random)
    for name, value in (told or {}).items():
        if not isinstance(value, str):
            told[name] = json.dumps(value)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, 'little') + text + data[8 + length:])


def _lie_in_bag(path: Path, random: Random) -> None:
    """Write a whole new bag, right in every checksum, some of whose messages are odd."""
    folder = path.parent
    share = random.choice((0.002, 0.05, 1.0))
    new = folder.with_name(folder.name + '_lies')
    odd = random.choice((garbage, wrong))
    with BagReader(folder) as reader, BagWriter(new) as writer:
        numbers = {}
        for message in reader.messages():
            topic = reader.topics[message.topic]
            if message.topic not in numbers:
                numbers[message.topic] = writer.add_topic(
                    message.topic, topic.type_name, topic.qos)
            data = message.data
            if random.random() < share and len(data) > 8:
                with contextlib.suppress(Exception):
                    # types that are not in the contract may not be installed
                    data = odd(topic.type_name, bytes(data), random)
            writer.write(numbers[message.topic], message.log_time, message.publish_time, data)
    shutil.rmtree(folder)
    new.rename(folder)
    written = next(folder.glob('*.mcap'))
    if written != path:
        written.rename(path)
        metadata = folder / 'metadata.yaml'
        metadata.write_text(metadata.read_text().replace(written.name, path.name))


class Originals:
    """
    One whole bag, run and model, made by the commands themselves; each fault has copies.

    Attributes:
        folder: where they lie.
    """

    def __init__(self, folder: Path, drive: Callable[[Path], object] | None = None) -> None:
        """
        Drive a lap and learn a little from it.

        Args:
            folder: a new one.
            drive: records another bag into a folder that it is given, with a decision a frame.

        Raises:
            AssertionError: that does not work.
        """
        self.folder = folder
        folder.mkdir()
        preset = folder / 'tiny.yaml'
        preset.write_text(yaml.safe_dump({**PRESET, 'action_repeat': 1, 'run_decisions': 300}))
        if drive is None:
            self._run('run', '--model', 'random', '--laps', '1', '--output', 'drive')
        else:
            (folder / 'drive').mkdir()
            drive(folder / 'drive' / 'bag')
        self._run('train', '--preset', 'tiny.yaml', '--run', 'run', '--from-bag', 'drive/bag')

    def _run(self, *words: str) -> None:
        ended = run_command(words, self.folder, seconds=COMMAND_SECONDS)
        assert ended.code == 0, (words, ended.code, ended.text[-2000:])

    def copy(self, place: Path) -> Path:
        """Return a fresh copy of everything."""
        shutil.rmtree(place, ignore_errors=True)
        return Path(shutil.copytree(self.folder, place))


FILES = {
    'bag': 'drive/bag/bag_0.mcap',
    'bag metadata': 'drive/bag/metadata.yaml',
    'checkpoint': 'run/checkpoint/checkpoint.safetensors',
    'weights': 'run/final/weights.safetensors',
    'model description': 'run/final/model.json',
    'preset': 'tiny.yaml',
    'run config': 'run/config.yaml',
    'run record': 'run/run.json',
    'episodes table': 'run/episodes.csv',
}
"""Where a file of the originals lies, by what it is called in the tables."""

GO_ON = ('train', '--resume', 'run', '--from-bag', 'drive/bag', '--set', 'run_decisions=340')
READERS: dict[str, tuple[tuple[str, ...], ...]] = {
    'bag': (('bag', 'info', 'drive/bag'), ('bag', 'verify', 'drive/bag'),
            ('bag', 'recover', 'drive/bag', 'whole'),
            ('bag', 'export', 'drive/bag', '--csv', 'steps.csv'),
            ('train', '--preset', 'tiny.yaml', '--run', 'again', '--from-bag', 'drive/bag')),
    'bag metadata': (('bag', 'info', 'drive/bag'), ('bag', 'verify', 'drive/bag')),
    'checkpoint': (GO_ON,),
    'weights': (('evaluate', '--model', 'run/final', '--episodes', '1', '--processes', '1',
                 '--simulator', 'fast', '--action-repeat', '10'),),
    'preset': (('train', '--preset', 'tiny.yaml', '--run', 'again', '--from-bag', 'drive/bag'),),
    'run config': (GO_ON, ('report', 'run')),
    'run record': (GO_ON, ('report', 'run')),
    'episodes table': (GO_ON, ('report', 'run')),
}
READERS['model description'] = READERS['weights']
"""The commands that read a file."""

NOTICE = {'bag': 'verify', 'checkpoint': 'train', 'weights': 'evaluate'}
"""Files with a checksum, and the command that must not say 0 of them when they are damaged."""

MOST_MIB = 1500


def try_file_fault(
    originals: Originals, place: Path, case: FileCase, seed: int,
) -> Outcome:
    """Damage one file of a copy and let one of the commands that read it read it."""
    outcome = Outcome('file', case.fault, case.file, seed)
    random = Random(f'{case.fault} {case.file} {seed}')
    folder = originals.copy(place)
    path = folder / FILES[case.file]
    damage: Callable | None = DAMAGE.get(case.fault)
    before = path.read_bytes()
    if damage is not None:
        path.write_bytes(damage(before, random))
    else:
        {'swap': swap, 'lie': lie}[case.fault](path, random)
    words = random.choice(READERS[case.file])
    same = path.is_file() and not path.is_symlink() and path.read_bytes() == before
    ended = run_command(words, folder, seconds=COMMAND_SECONDS)
    outcome.seconds = ended.seconds
    outcome.said = f'{" ".join(words[:2])}: {ended.code}: {ended.last_line}'
    outcome.problems += ended.problems()
    if ended.mib > MOST_MIB:
        outcome.problems.append(f'{" ".join(words[:2])} took {ended.mib:.0f} MiB')
    must = NOTICE.get(case.file)
    if damage is not None and must in words[:2] and ended.code == 0 and not same:
        outcome.problems.append(f'{" ".join(words[:2])} did not notice')
    return outcome
