# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing doctor` says what of the machine and of the graph is wrong, and what mends it."""
import io
import os

from carracing_dqn.bringup.doctor_command import BAD, GOOD, UNSURE
from carracing_dqn.bringup.findings_table import findings_table
from carracing_dqn.bringup.machine_checks import machine_findings
from carracing_dqn.simulation.fit import Finding
from graph_probe import carracing
import pytest
from rich.console import Console

WIDE = {'COLUMNS': '200'}


def doctor(**environment):
    return carracing('doctor', '--seconds', '1', timeout=120,
                     env={**os.environ, **WIDE, **environment})


def verdicts(monkeypatch, **environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return {one.name: one for one in machine_findings()}


def test_a_machine_that_passes_its_tests_is_well(own_domain):
    said = doctor()
    assert said.returncode == 0, said.stdout + said.stderr
    assert 'nodes find' in said.stdout and 'another node after' in said.stdout
    assert 'no node runs here' in said.stdout and 'carracing run' in said.stdout


@pytest.mark.parametrize(('environment', 'name', 'verdict', 'mend'), [
    ({'ROS_DOMAIN_ID': 'seven'}, 'domain', BAD, 'a number from 0'),
    ({'ROS_DOMAIN_ID': '300'}, 'domain', BAD, 'a number from 0'),
    ({'ROS_DOMAIN_ID': '150'}, 'domain', UNSURE, 'up to 101'),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, 'discovery', UNSURE, 'unset'),
    ({'FASTRTPS_DEFAULT_PROFILES_FILE': '/nowhere.xml'}, 'discovery', BAD, 'unset'),
    ({'FASTRTPS_DEFAULT_PROFILES_FILE': __file__}, 'discovery', UNSURE, 'firewall'),
    ({'RMW_IMPLEMENTATION': 'rmw_zenoh_cpp'}, 'discovery', UNSURE, 'firewall'),
    ({'ROS_LOG_DIR': '/proc/nowhere'}, 'home', BAD, 'ROS_LOG_DIR'),
])
def test_what_is_wrong_is_named_with_what_mends_it(
        monkeypatch, environment, name, verdict, mend):
    found = verdicts(monkeypatch, **environment)[name]
    assert found.verdict == verdict and mend in found.mend


def test_every_finding_that_is_not_good_has_a_cure(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    found = verdicts(monkeypatch)
    assert {'python', 'libraries', 'ROS', 'sockets', 'disk', 'GPU'} <= found.keys()
    assert all(one.mend for one in found.values() if one.verdict != GOOD)


@pytest.mark.parametrize(('environment', 'name'), [
    ({'ROS_LOG_DIR': '/proc/nowhere'}, 'home'), ({'ROS_DOMAIN_ID': 'foo'}, 'domain'),
    ({'ROS_DOMAIN_ID': '233'}, 'domain')])
def test_it_ends_with_1_before_it_looks_at_a_graph_that_cannot_be(environment, name):
    said = doctor(**environment)
    assert said.returncode == 1 and not said.stderr
    assert 'nodes find' not in said.stdout and f' {name} ' in said.stdout


def test_nothing_in_a_finding_is_more_than_text():
    console = Console(file=io.StringIO(), width=200)
    console.print(findings_table([Finding('/x\x1b[31m', BAD, '\x1b]0;OWNED\x07', '\x9b31m')]))
    assert 'OWNED' in console.file.getvalue()
    assert not set(console.file.getvalue()) & {'\x1b', '\x07', '\x9b'}


def test_a_faulty_graph_is_named_and_shown(graph):
    graph.node('dqn_policy_node', 'policy', model='random', cmd_vel_stamped=False)
    graph.node('carracing_sim_node', 'simulator', stepping='real_time')
    graph.spin_until(lambda: graph.probe.count_subscribers('cmd_vel'), 60, 'the simulator')
    said = carracing('doctor', '--seconds', '8', timeout=120, env={**os.environ, **WIDE})
    assert said.returncode == 1
    assert 'plain twist' in said.stdout and 'cmd_vel_stamped' in said.stdout
    assert f'/{graph.namespace}/image_raw' in said.stdout


def test_seconds_are_bounded():
    said = carracing('doctor', '--seconds', '0')
    assert said.returncode == 2 and said.stderr.count('\n') == 1
