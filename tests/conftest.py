# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Every file of tests has a ROS domain of its own on this host, and one thread per library."""
import contextlib
import itertools
import os
import signal
import warnings

from carracing_dqn.benchmarks.process_cost import children_of
from msgs_bridge.host_only import stay_on_this_host
import pytest

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
stay_on_this_host()
os.environ['OMP_NUM_THREADS'] = '1'
# what ignores it, as under nohup, hands that on to the nodes, which then go on when hung up
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# how a node of a test is started
CHILD = 'carracing_dqn.bringup.child'

_numbers = itertools.count()
_first_domain = int(os.environ.get('ROS_DOMAIN_ID', os.getpid()))


@pytest.fixture(autouse=True, scope='module')
def _domain_of_the_file():
    """Keep nodes of the files before, which may still be ending, from being met in this one."""
    os.environ['ROS_DOMAIN_ID'] = str(1 + (_first_domain + next(_numbers)) % 100)
    yield
    for pid, line in children_of(os.getpid()).items():
        if CHILD in line:
            warnings.warn(f'a test has left a node behind: {line}', stacklevel=1)
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@pytest.fixture
def graph(tmp_path):
    """Nodes in a namespace that no other test has."""
    from graph_probe import Graph
    with Graph(tmp_path, f'graph{next(_numbers)}') as graph:
        yield graph


@pytest.fixture
def terminal():
    """Start commands, each at a terminal of its own."""
    from terminal_probe import Terminal
    made = []

    def start(command):
        made.append(Terminal(command))
        return made[-1]

    yield start
    for one in made:
        one.close()


@pytest.fixture
def own_domain(monkeypatch):
    """Keep nodes of the tests before, which may have been killed, from being met in this one."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(102 + (os.getpid() + next(_numbers)) % 100))
