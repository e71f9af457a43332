# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A short, seeded sample of what `make faults` tries for an hour; see docs/reliability.md."""
from pathlib import Path
from random import Random

from bag_cases import record_drive
from faults import tables
from faults.fault_node import BY_NAME
from faults.file_faults import FILES, Originals, READERS, try_file_fault
from faults.message_faults import garbage, random_message, wrong
from faults.message_runner import try_message_fault
from faults.process_faults import FAULTS, try_process_fault
from faults.relay import KINDS, PASS, Relay
from faults.running_graph import NODES, RunningGraph
from msgs_bridge.message_types import message_class
from msgs_bridge.topics import TOPICS
from msgs_bridge.twists import Command
import pytest
from rclpy.serialization import deserialize_message, serialize_message

# a machine under test has other work: the promise of two seconds is held by `make faults`
PATIENT = 20.0

SAMPLE = (
    tables.MessageCase('off', 'image_raw'),
    tables.MessageCase('garbage', 'image_raw'),
    tables.MessageCase('wrong', 'cmd_vel'),
    tables.MessageCase('flooding', 'step', drives=tables.YES),
    tables.MessageCase('garbage', 'weights', drives=tables.YES),
)


def test_a_graph_survives_a_sample_of_faults(tmp_path):
    # before the graph, which has to end whatever happens to it
    outcomes = []
    graph = RunningGraph(tmp_path, 'sample')
    try:
        graph.wait_until_well(120)
        outcomes += [try_message_fault(graph, case, seed, seconds=1.5, promised=PATIENT)
                     for seed, case in enumerate(SAMPLE)]
        outcomes += [try_process_fault(graph, tables.ProcessCase(fault, node, ends), 0,
                                       promised=PATIENT)
                     for fault, node, ends in (('kill', 'policy', True),
                                               ('stop and continue', 'recorder', False))]
    finally:
        outcomes.append(graph.end())
    assert not [outcome.line() for outcome in outcomes if not outcome.survived]


@pytest.fixture(scope='module')
def originals(tmp_path_factory):
    """Return a bag, a run that has learned from it, and its model."""
    commands = [Command(1.0, 0.0), Command(0.0, 1.0), Command(0.0, 0.0), Command(0.0, -1.0)]
    return Originals(tmp_path_factory.mktemp('files') / 'originals', lambda bag: record_drive(
        bag, episodes=4, decisions=100,
        drive_with=lambda number: commands[number // 7 % len(commands)]))


@pytest.mark.parametrize('case', [
    case for case in tables.FILES if case.file in ('bag', 'bag metadata', 'weights', 'preset')],
    ids=lambda case: f'{case.fault} {case.file}')
def test_damaged_and_lying_files_are_told_in_a_line(originals, tmp_path, case):
    outcome = try_file_fault(originals, tmp_path / 'copy', case, seed=2)
    assert outcome.survived, outcome.line()


def number(value: int) -> bytes:
    message = message_class('std_msgs/msg/Float32')()
    message.data = float(value)
    return serialize_message(message)


@pytest.mark.parametrize('kind', [PASS, *KINDS])
def test_a_relay_hands_on_again_as_before_once_a_fault_has_ended(kind):
    relay = Relay('std_msgs/msg/Float32')
    relay.begin(kind, 1.0, seed=3, now=0.0)
    sent, out = [number(value) for value in range(200)], []
    for index, data in enumerate(sent):
        now = index / 100
        out.append(relay.arrived(data, now) + relay.due(now))
    first, last = sum(out[:100], []), sum(out[105:], [])
    assert last == sent[105:]
    if kind in ('off', 'slow', 'intermittent'):
        assert len(first) < 60
    elif kind in ('delayed', 'reordered'):
        assert first != sent[:100] and set(sum(out, [])) == set(sent)
    elif kind != PASS:
        assert len(first) > 90 and first != sent[:100]


@pytest.mark.parametrize('topic', TOPICS, ids=lambda topic: topic.name)
def test_bad_messages_are_the_same_for_a_seed_and_none_is_the_true_one_for_long(topic):
    true = serialize_message(random_message(topic.type_name, Random(1)))
    for make in (garbage, wrong):
        random, again = Random(7), Random(7)
        made = [make(topic.type_name, true, random) for _ in range(40)]
        # what pads a message is whatever lay in memory
        assert list(map(len, made)) == [len(make(topic.type_name, true, again)) for _ in made]
        assert any(data != true for data in made)
    for data in made:
        # a lie is well-formed
        deserialize_message(data, message_class(topic.type_name))


def test_every_row_of_the_tables_names_what_there_is():
    assert {case.kind for case in tables.MESSAGES} == set(KINDS)
    assert {case.topic for case in tables.MESSAGES} == set(BY_NAME)
    assert {case.fault for case in tables.PROCESSES} == set(FAULTS)
    assert {case.node for case in tables.PROCESSES} == set(NODES)
    assert {case.file for case in tables.FILES} == set(FILES) == set(READERS)
    page = (Path(__file__).parents[2] / 'docs' / 'reliability.md').read_text()
    assert not [kind for kind in KINDS if kind not in page]
