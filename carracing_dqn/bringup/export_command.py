# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""`carracing export`: a model as a file for other programs."""
from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from carracing_dqn.evaluation.policies import model_source
from msgs_bridge.atomic_write import write_bytes
from msgs_bridge.errors import BridgeError
from msgs_bridge.terminal import say
from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `carracing export`."""
    parser.add_argument('model', metavar='DIR|NAME', help='model folder, run folder (its best '
                        'model) or name of a shipped model')
    parser.add_argument('--onnx', type=Path, required=True, metavar='FILE',
                        help='new ONNX file: rgb frames in, Q-values and command out')


def main(arguments: argparse.Namespace) -> int:
    """Write the file; return the exit code."""
    if importlib.util.find_spec('onnx') is None:
        raise BridgeError("onnx is not installed: pip install '.[onnx]'")
    if arguments.onnx.exists():
        raise BridgeError(f'{arguments.onnx} exists already; nothing was overwritten')
    source = model_source(arguments.model)
    # on first use, because torch takes a second to load
    from dqn_policy_node.model_folder import load_model
    from dqn_policy_node.onnx_export import metadata, to_onnx
    model = load_model(source.model)
    try:
        write_bytes(arguments.onnx, to_onnx(model, source.name))
    except OSError as error:
        raise BridgeError(f'{arguments.onnx} cannot be written: {error.strerror}') from None
    told, own = metadata(model.description, source.name), model.description.preprocessing
    console = Console()
    for line in (
        f'wrote {arguments.onnx}',
        f'in   frames    uint8 (N, {told["frame_stack"]}, {own.frame_height}, {own.frame_width}, '
        f'3), oldest first, {told["stack_seconds"]} s apart',
        f'out  q_values  float32 (N, {len(model.description.action_space)})',
        f'out  command   float64 (N, 2), held for {told["action_seconds"]} s',
    ):
        say(console, line)
    return 0
