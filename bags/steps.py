# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`step` bundles out of bags, those of version 0.1 among them."""
from __future__ import annotations

from typing import Any

from bags.decode import decode_bundle
from carracing_sim_node.controls import command_of
from msgs_bridge.step import read_step, Step

PEDALS = ('steer', 'gas', 'brake')


def decode_step(data: Any, what: str) -> tuple[int, Step]:
    """
    Return stamp in ns and step; `what` names the message in errors.

    Bags of version 0.1 say which controls were applied where later ones have the command.

    Raises:
        BagError: the bytes are not a JointState.
        MessageError: not a step that can be used.
    """
    bundle = decode_bundle(data, what)
    step = read_step(bundle.values_with())
    if 'linear' not in step.info and all(name in step.info for name in PEDALS):
        step.info.update(command_of(*(step.info[name] for name in PEDALS))._asdict())
    return bundle.stamp, step
