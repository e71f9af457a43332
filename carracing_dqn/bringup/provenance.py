# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: versions and parameters, as JSON for its bag."""
from __future__ import annotations

import dataclasses
import json
from typing import Any

from carracing_dqn.bringup.graph import Graph, RECORDER
from msgs_bridge.machine import describe_machine


def with_provenance(graph: Graph, **more: Any) -> Graph:
    """
    Return a graph whose recorder, if it has one, writes where the recording comes from.

    Args:
        graph: its nodes' parameters are written by role.
        more: further JSON values by name, in place of parameters of that name.
    """
    origin = {'machine': describe_machine()}
    for node in graph:
        if node.kind is not RECORDER:
            origin[node.kind.role] = {**node.parameters, **{
                name: value for name, value in more.items() if name in node.parameters}}
    return tuple(
        dataclasses.replace(node, parameters={
            **node.parameters, 'provenance': json.dumps(origin, sort_keys=True)})
        if node.kind is RECORDER else node for node in graph)
