# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Every test session has a ROS domain of its own on this host, and one thread per library."""
import itertools
import os
import signal

from msgs_bridge.host_only import stay_on_this_host
import pytest

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
stay_on_this_host()
os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
os.environ['OMP_NUM_THREADS'] = '1'
# what ignores it, as under nohup, hands that on to the nodes, which then go on when hung up
signal.signal(signal.SIGHUP, signal.SIG_DFL)

_numbers = itertools.count()


@pytest.fixture
def graph(tmp_path):
    """Nodes in a namespace that no other test has."""
    from graph_probe import Graph
    with Graph(tmp_path, f'graph{next(_numbers)}') as graph:
        yield graph
