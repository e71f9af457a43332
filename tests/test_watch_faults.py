# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Each of ten faulty graphs of real nodes is named by what is watched."""
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
import os

from carracing_dqn.watch.live_node import LiveSource
from graph_probe import Graph, wait_for
import pytest
from watch_faults import FAULTS

SECONDS = 270
"""Ten graphs start on two cores, one after another or two at a time; a person has five minutes."""


@pytest.fixture
def source():
    source = LiveSource(domain=os.environ['ROS_DOMAIN_ID'])
    yield source
    source.close()


def found(source, namespace):
    """Return the causes that are named of a namespace."""
    return [cause for cause in source.state.snapshot(source.now())['causes']
            if cause['where'].startswith(f'/{namespace}/')]


def names_it(source, namespace, fault):
    return any(cause['kind'] in fault.kinds and cause['where'] == f'/{namespace}{fault.where}'
               for cause in found(source, namespace))


BATCHES = [list(FAULTS)[begin::3] for begin in range(3)]


@pytest.mark.parametrize('names', BATCHES)
def test_each_fault_is_named(source, tmp_path, names):
    with ExitStack() as stack, ThreadPoolExecutor() as threads:
        running = []
        for name in names:
            namespace = name.lower().replace(' ', '_').replace('-', '_')
            folder = tmp_path / namespace
            folder.mkdir()
            graph = stack.enter_context(Graph(folder, namespace))
            running.append((FAULTS[name], namespace, threads.submit(FAULTS[name].prepare, graph)))
        for fault, namespace, prepared in running:
            prepared.result()
            wait_for(lambda: names_it(source, namespace, fault), SECONDS,  # noqa: B023
                     f'{namespace} is named; {found(source, namespace)}')
        assert source.failed == 0
        assert source.state.snapshot(source.now())['rejected'] == 0
