# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The learning graph with `fault_node` on every topic, and how one sees that it is well."""
from __future__ import annotations

from collections import deque
import dataclasses
import os
from pathlib import Path
import signal
import time

from carracing_dqn.bringup.processes import node_command
from faults import bags_left
from faults.fault_node import UPSTREAM
from faults.outcome import Outcome
from graph_probe import Graph
from msgs_bridge import topics
from msgs_bridge.message_types import message_class
from msgs_bridge.qos import qos_profile
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
import yaml

TESTS = Path(__file__).resolve().parents[1]

PRESET = {
    'convolutions': '8@8/4 8@4/2', 'hidden': 16, 'shrink': 2, 'action_repeat': 4,
    'early_end_frames': 60, 'learning_starts': 50, 'replay_capacity': 5000, 'weights_every': 10,
    'samples_per_transition': 1.0, 'validation_tracks': 1, 'validation_every_episodes': 0,
    'validation_every_minutes': 0.1, 'run_episodes': 0, 'checkpoint_every_minutes': 0.05,
}
"""A network that learns from each transition in no time: the graph is tried, not the learning."""

NODES = {
    'simulator': ('carracing_sim_node', 'carracing_sim_node',
                  ('image_raw', 'step', 'reward', 'episode', '/clock')),
    'policy': ('dqn_policy_node', 'dqn_policy_node', ('cmd_vel', 'q_values')),
    'trainer': ('trainer_node', 'trainer_node', ('weights',)),
    'validator': ('carracing_dqn.evaluation.node', 'validation_node', ('validation',)),
    'recorder': ('bags.recorder_node', 'bag_recorder_node', ()),
}
"""Role -> module, name of the node, topics that it publishes beside its diagnostics."""

START_ORDER = ('recorder', 'trainer', 'policy', 'validator', 'simulator')

WINDOW_SECONDS = 0.5
"""Over which the rate of decisions is taken."""

AS_BEFORE = 0.25
"""Share of the rate before that counts as driving again: a machine has other work as well."""

FRESH_SECONDS = 10.0
"""Age of diagnostics from which a node counts as hung; the validator is silent while it drives."""

MOST_GROWTH_MIB = 500
"""By which a process may grow over all faults of a graph."""

MIB = 1 << 20


@dataclasses.dataclass
class Word:
    """What a node said of itself last."""

    at: float
    level: int
    summary: str
    values: dict[str, str]

    @property
    def lasting(self) -> bool:
        """Return whether it says what cannot be well again: what a bag lacks it lacks for good."""
        return 'messages were lost' in self.summary


class RunningGraph(Graph):
    """Five nodes and the faulty one; a context manager that stops them all."""

    def __init__(self, folder: Path, namespace: str) -> None:
        """Start every node; `wait_until_well` says when they drive and learn."""
        super().__init__(folder, namespace)
        self.folder = folder
        self.bags = 0
        self.started: dict[str, float] = {}
        self.at_first: dict[str, float] = {}
        self.said: dict[str, deque[Word]] = {
            role: deque(maxlen=200) for role in NODES}
        self._decisions: deque[float] = deque(maxlen=5000)
        preset = folder / 'tiny.yaml'
        preset.write_text(yaml.safe_dump(PRESET))
        health, step = topics.DIAGNOSTICS, topics.STEP
        self.probe.create_subscription(
            message_class(health.type_name), health.name + UPSTREAM, self._on_health,
            qos_profile(health, depth=100))
        self.probe.create_subscription(
            message_class(step.type_name), step.name + UPSTREAM,
            lambda _: self._decisions.append(time.monotonic()), qos_profile(step), raw=True)
        self._set = self.probe.create_client(SetParameters, 'fault_node/set_parameters')
        # the node lies beside the tests
        os.environ['PYTHONPATH'] = os.pathsep.join(
            filter(None, (str(TESTS), os.environ.get('PYTHONPATH'))))
        self.start('fault_node', node_command('faults.fault_node', {}, self.namespace))
        for role in START_ORDER:
            self.start_role(role)

    def start_role(self, role: str, *, resume: bool = False) -> None:
        """Start a node, or start it again."""
        module, _, published = NODES[role]
        if role == 'recorder':
            self.bags += 1
        parameters = {
            'simulator': {'action_repeat': 4, 'early_end_frames': 60, 'seed_each_episode': True,
                          'answer_timeout': 0.5},
            'policy': {'model': '', 'explore': True, 'wait_for_subscribers': 1},
            'trainer': {'run': str(self.folder / 'run'), 'resume': resume,
                        'preset': str(self.folder / 'tiny.yaml')},
            'validator': {'tracks': 1},
            'recorder': {'folder': str(self.folder / f'bag{self.bags}')},
        }[role]
        command = node_command(module, parameters, self.namespace)
        for name in (*published, topics.DIAGNOSTICS.name):
            command += ['-r', f'{name}:={name}{UPSTREAM}']
        self.started[role] = time.monotonic()
        self.start(role, command, keeps=role in ('trainer', 'recorder'))

    def _on_health(self, message: object) -> None:
        for status in message.status:
            for role, (_, name, _) in NODES.items():
                if status.name == f'/{self.namespace}/{name}':
                    self.said[role].append(Word(
                        time.monotonic(), status.level[0], status.message,
                        {pair.key: pair.value for pair in status.values}))

    # --- what is seen

    def rate(self, seconds: float = WINDOW_SECONDS) -> float:
        """Return decisions a second, lately."""
        since = time.monotonic() - seconds
        return sum(at > since for at in self._decisions) / seconds

    def word(self, role: str) -> Word | None:
        """Return what a node said last, None if nothing since it was started."""
        words = self.said[role]
        return words[-1] if words and words[-1].at > self.started[role] else None

    def learned(self) -> list[float]:
        """Return how many transitions the trainer had joined, newest last."""
        return [float(word.values.get('transitions_joined', word.values.get('decisions', 0)))
                for word in self.said['trainer'] if word.at > self.started['trainer']]

    def what_is_wrong(self, since: float = 0.0, rate: float = 1.0) -> str:
        """Return what keeps the graph from being well, empty if nothing does."""
        now = time.monotonic()
        for role in NODES:
            word = self.word(role)
            if word is None or now - word.at > FRESH_SECONDS:
                return f'{role} says nothing'
            if word.level != 0 and not word.lasting:
                return f'{role} says {word.summary!r}'
            if word.at < since and role != 'validator':
                return f'{role} has not spoken since'
        if self.rate() < AS_BEFORE * rate:
            return f'{self.rate():.0f} decisions/s'
        learned = self.learned()
        if len(learned) < 2 or learned[-1] <= learned[-2]:
            return 'no transitions are joined'
        return ''

    def levels(self, begin: float, end: float) -> list[str]:
        """Return who said more than OK in a span of time, and what; not what lasts from before."""
        found = []
        for role, words in self.said.items():
            before = [word for word in words if word.at <= begin and word.lasting]
            found += [f'{role}: {word.summary}' for word in words
                      if begin < word.at < end and word.level != 0
                      and not (word.lasting and before)]
        return found

    def wait_until_well(self, seconds: float, *, since: float = 0.0, rate: float = 4.0) -> float:
        """
        Wait until the graph is well; return how long it took.

        Raises:
            TimeoutError: it is not in time; says why.
        """
        began = time.monotonic()
        while wrong := self.what_is_wrong(since, rate):
            if time.monotonic() - began > seconds:
                raise TimeoutError(wrong)
            if dead := self.dead():
                raise TimeoutError(dead)
            self.spin(0.05)
        self.at_first = self.at_first or self.resident()
        return time.monotonic() - began

    def dead(self) -> str:
        """Return which process has ended, and its last line."""
        for name, child in self.children.items():
            if child.code is not None:
                return f'{name} ended with {child.code}: {" ".join(list(child.words)[-1:])[:150]}'
        return ''

    def logged(self) -> dict[str, int]:
        """Return the size of every log so far."""
        return {path.name: path.stat().st_size for path in self.folder.glob('*.log')}

    def log_problems(self, before: dict[str, int]) -> list[str]:
        """Return what stands in the logs since then that must not."""
        problems = []
        for path in sorted(self.folder.glob('*.log')):
            if path.stem == 'fault_node':
                continue
            with path.open('rb') as file:
                file.seek(before.get(path.name, 0))
                text = file.read().decode(errors='replace')
            if 'Traceback' in text:
                last = text[text.rindex('Traceback'):].strip().splitlines()
                problems.append(f'{path.stem}: traceback: {last[-1][:120]}')
            if len(text) > MIB:
                problems.append(f'{path.stem} logged {len(text) / MIB:.1f} MiB')
            if '\x1b' in text:
                problems.append(f'{path.stem} logged an escape sequence')
        return problems

    def resident(self) -> dict[str, float]:
        """Return MiB in memory, process by process."""
        found = {}
        for name, child in self.children.items():
            try:
                pages = int(Path(f'/proc/{child.process.pid}/statm').read_text().split()[1])
            except (OSError, IndexError):
                continue
            found[name] = pages * os.sysconf('SC_PAGESIZE') / MIB
        return found

    # --- what is done

    def set_fault(self, topic: str, kind: str, seconds: float, seed: int) -> None:
        """
        Let `fault_node` begin a fault.

        Raises:
            AssertionError: it does not answer, or does not know the fault.
        """
        self.spin_until(self._set.service_is_ready, 20, 'fault_node is there')
        value = Parameter('fault', value=f'{topic} {kind} {seconds} {seed}')
        future = self._set.call_async(
            SetParameters.Request(parameters=[value.to_parameter_msg()]))
        self.spin_until(future.done, 10, 'fault_node answers')
        result = future.result().results[0]
        assert result.successful, result.reason

    def end(self) -> Outcome:
        """Stop every node as Ctrl-C does and look at what is left."""
        outcome = Outcome('process', 'interrupt', 'everything', 0)
        logged, memory = self.logged(), self.resident()
        for name, now in memory.items():
            if now - self.at_first.get(name, now) > MOST_GROWTH_MIB and name != 'fault_node':
                outcome.problems.append(
                    f'{name} has grown from {self.at_first[name]:.0f} to {now:.0f} MiB')
        began = time.monotonic()
        recorder = self.children['recorder']
        self.__exit__()
        outcome.seconds = time.monotonic() - began
        outcome.problems += self.log_problems(logged)
        for name, child in self.children.items():
            if child.code not in (0, 130, -signal.SIGINT) and name != 'fault_node':
                outcome.problems.append(f'{name} ended with {child.code}')
        outcome.said = ' '.join(list(recorder.words)[-1:])
        for bag in sorted(self.folder.glob('bag*')):
            outcome.problems += bags_left.what_is_wrong(bag, self.folder)
        return outcome
