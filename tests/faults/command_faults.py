# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Whole commands under signals, limits, removed folders and messages of strangers."""
from __future__ import annotations

import contextlib
import os
from pathlib import Path
from random import Random
import shutil
import signal
import subprocess
import sys
import time

from faults.bags_left import what_is_wrong
from faults.command_process import LONGEST_LINE
from faults.message_faults import garbage, wrong
from faults.outcome import Outcome
from faults.running_graph import PRESET
from faults.tables import CommandCase
from msgs_bridge import topics
from msgs_bridge.message_types import message_class
from msgs_bridge.qos import qos_profile
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
import yaml

WORDS = {
    'run': ('run', '--model', 'random', '--laps', '1', '--output', 'drive'),
    'train': ('train', '--preset', 'tiny.yaml', '--run', 'run', '--bag'),
}
"""The commands; neither would end by itself within the fault, apart from one lap."""

LONG = {'run': ('run', '--model', 'random', '--laps', '100000', '--output', 'drive'),
        'train': WORDS['train']}

BAGS = {'run': 'drive/bag', 'train': 'run/bag'}
MARK = 'CARRACING_FAULTS_MARK'

SIGNALS = {'kill': signal.SIGKILL, 'terminate': signal.SIGTERM, 'hang up': signal.SIGHUP,
           'interrupt': signal.SIGINT}

LIMITS = {
    # what `ulimit` is given: files, KiB of a file, KiB of memory
    'few descriptors': ('-n', (16, 24, 40)),
    'out of disk': ('-f', (0, 64, 400)),
    'little memory': ('-v', (300_000, 700_000, 1_500_000)),
}

UP_SECONDS = 60.0
END_SECONDS = 30.0
LAP_SECONDS = 150.0
ATTACK_SECONDS = 4.0


def processes(mark: str) -> dict[int, str]:
    """Return pid -> command line of every process that a marked command has started."""
    found = {}
    for entry in Path('/proc').iterdir():
        if not entry.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            if f'{MARK}={mark}'.encode() in (entry / 'environ').read_bytes().split(b'\0'):
                found[int(entry.name)] = (entry / 'cmdline').read_bytes().replace(
                    b'\0', b' ').decode(errors='replace')
    return found


class RunningCommand:
    """A command, the file that takes what it says, and every process it has started."""

    def __init__(self, words: tuple[str, ...], folder: Path, limit: tuple[str, ...] = ()) -> None:
        """Start it in a folder, under a `ulimit` if one is given."""
        self.mark = f'{os.getpid()}-{time.monotonic_ns()}'
        self.said = folder / 'said.txt'
        command = [sys.executable, '-m', 'carracing_dqn.bringup', *words]
        if limit:
            command = ['bash', '-c', f'ulimit {" ".join(limit)}; exec "$@"', 'bash', *command]
        with self.said.open('wb') as file:
            self.process = subprocess.Popen(
                command, cwd=folder, stdout=file, stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL, start_new_session=True,
                env={**os.environ, MARK: self.mark})
        self.began = time.monotonic()

    def wait(self, seconds: float) -> int | None:
        """Return its exit code, None if it does not end in time."""
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            return None

    def child(self, module: str) -> int | None:
        """Return the process of a node."""
        return next((pid for pid, line in processes(self.mark).items()
                     if f' {module} ' in line or f' {module}.node ' in line), None)

    def left_over(self, seconds: float) -> list[str]:
        """Return processes that are still there after some seconds; they are killed."""
        until = time.monotonic() + seconds
        while (left := processes(self.mark)) and time.monotonic() < until:
            time.sleep(0.1)
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return [line[:150] for line in left.values()]

    @property
    def text(self) -> str:
        """Return what it has said."""
        return self.said.read_text(errors='replace')


MODULES = {'simulator': 'carracing_sim_node', 'policy': 'dqn_policy_node',
           'trainer': 'trainer_node', 'recorder': 'bags.recorder_node'}


def try_command_fault(place: Path, case: CommandCase, seed: int) -> Outcome:
    """Start a command in a fresh folder, do something to it, and return how it ended."""
    outcome = Outcome('command', case.fault, f'{case.command} {case.part}'.strip(), seed)
    random = Random(f'{case} {seed}')
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    (place / 'tiny.yaml').write_text(yaml.safe_dump({**PRESET, 'run_minutes': 30.0}))
    limit = ()
    words = LONG[case.command]
    if case.fault in LIMITS:
        name, values = LIMITS[case.fault]
        limit = name, str(random.choice(values))
        words = WORDS['run'] if case.command == 'run' else words
    if case.fault in ('garbage', 'wrong'):
        words = WORDS[case.command]
    command = RunningCommand(words, place, limit)
    try:
        code = _do(command, case, random, place, outcome)
    finally:
        left = command.left_over(END_SECONDS)
    outcome.seconds = time.monotonic() - command.began
    text = command.text
    lines = text.strip().splitlines()
    outcome.said = f'{code}: {lines[-1] if lines else ""}'
    if left:
        outcome.problems.append(f'left over: {"; ".join(left)}')
    outcome.problems += _judge(case, code, text, place)
    return outcome


def _do(command: RunningCommand, case: CommandCase, random: Random, place: Path,
        outcome: Outcome) -> int | None:
    """Do the fault to a command; return how it ended."""
    if case.fault in LIMITS:
        # under a limit it may as well go on
        code = command.wait(LAP_SECONDS if case.command == 'run' else END_SECONDS)
        if code is None and case.command == 'train':
            command.process.send_signal(signal.SIGINT)
            code = command.wait(END_SECONDS)
        return code
    if case.fault in ('garbage', 'wrong'):
        _attack(case, random, place)
        if case.command == 'train':
            command.process.send_signal(signal.SIGINT)
            return command.wait(END_SECONDS)
        return command.wait(LAP_SECONDS)
    if case.part != 'starting':
        _wait_until_up(place / BAGS[case.command], command)
    time.sleep(random.uniform(0.0, 4.0))
    if case.fault == 'folder removed':
        shutil.rmtree(place / Path(BAGS[case.command]).parts[0], ignore_errors=True)
    elif case.part in MODULES:
        pid = command.child(MODULES[case.part])
        if pid is None:
            outcome.problems.append(f'there is no {case.part}')
        else:
            os.kill(pid, SIGNALS[case.fault])
    else:
        command.process.send_signal(SIGNALS[case.fault])
    return command.wait(END_SECONDS)


def _wait_until_up(bag: Path, command: RunningCommand) -> None:
    """Wait until the nodes drive: the bag grows beyond its first messages."""
    until = time.monotonic() + UP_SECONDS
    while time.monotonic() < until and command.process.poll() is None:
        if sum(file.stat().st_size for file in bag.glob('*.mcap')) > 100_000:
            return
        time.sleep(0.1)


def _attack(case: CommandCase, random: Random, place: Path) -> None:
    """Publish bad messages beside the true ones, made of one that was heard."""
    topic = next(topic for topic in topics.TOPICS if topic.name == case.part)
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('stranger', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard: list[bytes] = []
    kind = message_class(topic.type_name)
    node.create_subscription(
        kind, topic.name, lambda data: heard.append(data) if not heard else None,
        qos_profile(topic), raw=True)
    try:
        until = time.monotonic() + UP_SECONDS
        while not heard and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.1)
        # not before: a command refuses to start beside somebody who publishes images
        publisher = node.create_publisher(kind, topic.name, qos_profile(topic))
        odd = {'garbage': garbage, 'wrong': wrong}[case.fault]
        until = time.monotonic() + ATTACK_SECONDS
        while heard and time.monotonic() < until:
            publisher.publish(odd(topic.type_name, heard[0], random))
            time.sleep(0.02)
    finally:
        executor.shutdown(timeout_sec=1)
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def _judge(case: CommandCase, code: int | None, text: str, place: Path) -> list[str]:
    """Return what is wrong with how a command ended."""
    problems = []
    lines = text.splitlines()
    if code is None:
        problems.append('hung')
    elif code not in case.codes:
        problems.append(f'code {code}; accepted: {case.codes}')
    if 'Traceback' in text:
        problems.append(f'traceback: {lines[-1][:150]}')
    # what it says lies on the same disk, and may have no room at all
    if code == 2 and not any('error: ' in line for line in lines) and (
            text or case.fault != 'out of disk'):
        problems.append('code 2 without an error line')
    if max(map(len, lines), default=0) > LONGEST_LINE:
        problems.append(f'a line of {max(map(len, lines))} characters')
    for log in sorted(place.glob('*/log/*.log')):
        if case.fault not in LIMITS and 'Traceback' in (said := log.read_text(errors='replace')):
            problems.append(f'{log.stem}: traceback: {said.strip().splitlines()[-1][:120]}')
    bag = place / BAGS[case.command]
    if not problems and any(bag.glob('*.mcap')):
        problems += what_is_wrong(bag, place)
    return problems
