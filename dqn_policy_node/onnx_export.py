# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
A model as an ONNX graph, for programs without this package and without PyTorch.

The graph begins with whole rgb frames: cropping, gray and shrinking are whole-number operators in
it, equal to `Preprocessor` to the bit, so that who runs it has nothing to make again. It is put
together operator by operator, because only convolutions and layers could be traced.
"""
from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper, TensorProto

from dqn_policy_node.action_space import ActionSpace, Discrete
from dqn_policy_node.axis_actions import Hybrid
from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import ModelDescription, Preprocessing
from dqn_policy_node.model_folder import Model
from dqn_policy_node.preprocessing import LUMA, Preprocessor

TOLERANCE = 1e-4
"""Most that a Q-value differs from that of `Policy`, times its size where that is above 1."""

# of 2022: runtimes of that age and younger take them
OPSET = 17
IR_VERSION = 8


class _Graph:
    """Nodes one after the other, each named by its output, and the constants that they take."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, dtype: Any) -> str:
        """Add a constant; return its name."""
        name = f'constant_{len(self.constants)}'
        array = np.ascontiguousarray(values, dtype)
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def numbers(self, *values: int) -> str:
        """Add int64 numbers, as shapes and axes are; return their name."""
        return self.constant(values, np.int64)

    def add(self, kind: str, *inputs: str, output: str = '', **attributes: Any) -> str:
        """Add a node of an operator; return the name of its output."""
        output = output or f'{kind}_{len(self.nodes)}'
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output


def to_onnx(model: Model, name: str) -> bytes:
    """
    Return a model as the bytes of an ONNX file.

    Input `frames`: uint8 (N, frame_stack, frame_height, frame_width, 3) rgb, oldest first,
    `stack_seconds` apart. Outputs: `q_values`, float32 (N, outputs), and `command`, float64
    (N, 2), linear and angular of the best action, to be held for `action_seconds`. The metadata
    hold these numbers by name, and `description`, all of `model.json`'s.

    Raises:
        ModelError: its actions are of a kind that is not known here.
    """
    description = model.description
    graph = _Graph()
    observations = _observations(graph, description.preprocessing, description.frame_stack)
    _q_values(graph, observations, model)
    _command(graph, description.action_space)
    own = description.preprocessing
    frames = ['N', description.frame_stack, own.frame_height, own.frame_width, 3]
    outputs = len(description.action_space)
    made = helper.make_model(
        helper.make_graph(
            graph.nodes, 'policy',
            [helper.make_tensor_value_info('frames', TensorProto.UINT8, frames)],
            [helper.make_tensor_value_info('q_values', TensorProto.FLOAT, ['N', outputs]),
             helper.make_tensor_value_info('command', TensorProto.DOUBLE, ['N', 2])],
            graph.constants),
        opset_imports=[helper.make_opsetid('', OPSET)], ir_version=IR_VERSION,
        producer_name='carracing_dqn', model_version=model.version, doc_string=to_onnx.__doc__)
    helper.set_model_props(made, metadata(description, name))
    onnx.checker.check_model(made, full_check=True)
    return made.SerializeToString()


def metadata(description: ModelDescription, name: str) -> dict[str, str]:
    """Return what who runs the graph has to know, as texts by name."""
    return {
        'name': name,
        'frame_stack': str(description.frame_stack),
        'stack_seconds': f'{description.stack_seconds:g}',
        'action_seconds': f'{description.action_seconds:g}',
        'actions': json.dumps(description.action_space.names),
        'command': 'linear (gas above 0, brake below), angular (left above 0), from -1 to 1',
        'description': json.dumps(description.to_json()),
        'license': 'Apache-2.0',
    }


def _observations(graph: _Graph, own: Preprocessing, stack: int) -> str:
    """Add what `Preprocessor` does; return its output, float32 (N, stack, H, W), 0 to 255."""
    preprocessor = Preprocessor(own)
    ends = own.first_row + own.rows, own.first_column + own.columns
    part = graph.add('Slice', 'frames', graph.numbers(own.first_row, own.first_column),
                     graph.numbers(*ends), graph.numbers(2, 3))
    weights = (1, 1, 1) if own.gray == 'mean' else LUMA
    sums = graph.add('MatMulInteger', part, graph.constant([[one] for one in weights], np.uint8))
    sums = graph.add('Squeeze', sums, graph.numbers(4))
    gray = graph.add('Gather', graph.constant(preprocessor.level_of_sum, np.int32), sums)
    if own.shrink > 1:
        height, width = own.shape
        squares = graph.add('Reshape', gray, graph.numbers(
            -1, stack, height, own.shrink, width, own.shrink))
        area = own.shrink ** 2
        total = graph.add('ReduceSum', squares, graph.numbers(3, 5), keepdims=0)
        rounded = graph.add('Add', total, graph.constant(area // 2, np.int32))
        gray = graph.add('Div', rounded, graph.constant(area, np.int32))
    return graph.add('Cast', gray, to=TensorProto.FLOAT)


def _q_values(graph: _Graph, x: str, model: Model) -> None:
    """Add what `QNetwork` does, up to the output `q_values`."""
    network = model.description.network
    weights = {name: tensor.numpy() for name, tensor in model.tensors.items()}

    def linear(layer: str, inputs: str, **names: str) -> str:
        return graph.add('Gemm', inputs, *(
            graph.constant(weights[f'{layer}.{kind}'], np.float32) for kind in ('weight', 'bias')),
            transB=1, **names)

    for index, layer in enumerate(network.convolutions):
        weight = weights[f'convolutions.{index}.weight']
        x = graph.add('Relu', graph.add(
            'Conv', x,
            graph.constant(weight * np.float32(1 / 255) if index == 0 else weight, np.float32),
            graph.constant(weights[f'convolutions.{index}.bias'], np.float32),
            strides=[layer.stride, layer.stride]))
    flat = graph.add('Flatten', graph.add('Transpose', x, perm=[0, 2, 3, 1]))
    x = graph.add('Relu', linear('hidden', flat))
    outputs, quantiles = len(model.description.action_space), network.quantiles
    if not network.dueling:
        values = graph.add('Reshape', linear('output', x), graph.numbers(-1, outputs, quantiles))
    else:
        half, zero, axis = network.hidden // 2, graph.numbers(0), graph.numbers(1)
        of_value = graph.add('Slice', x, zero, graph.numbers(half), axis)
        of_advantage = graph.add('Slice', x, graph.numbers(half), graph.numbers(2 * half), axis)
        value = graph.add(
            'Reshape', linear('value', of_value), graph.numbers(-1, 1, quantiles))
        advantage = graph.add(
            'Reshape', linear('advantage', of_advantage), graph.numbers(-1, outputs, quantiles))
        mean = graph.add('ReduceMean', advantage, axes=[1], keepdims=1)
        values = graph.add('Sub', graph.add('Add', value, advantage), mean)
    graph.add('ReduceMean', values, axes=[2], keepdims=0, output='q_values')


def _command(graph: _Graph, space: ActionSpace) -> None:
    """Add the output `command`, of the choice that is worth most."""
    weights, commands = _choices(space)
    values = 'q_values'
    if weights is not None:
        values = graph.add('MatMul', values, graph.constant(weights, np.float32))
    best = graph.add('ArgMax', values, axis=1, keepdims=0)
    # as exact as ours: physics may tell 0.3 from its nearest float32
    graph.add('Gather', graph.constant(commands, np.float64), best, output='command')


def _choices(space: ActionSpace) -> tuple[np.ndarray | None, np.ndarray]:
    """
    Return everything that can be the best action.

    Returns:
        (outputs, choices), what the value of a choice takes from each output, or None where each
        output is a choice; and (choices, 2), their commands.

    Raises:
        ModelError: a kind that is not known here.
    """
    if isinstance(space, Discrete):
        return None, np.array(space.commands)
    if not isinstance(space, Hybrid):
        raise ModelError(f'actions of kind {space.kind!r} cannot be written as ONNX')
    columns, commands = [], []
    for mode, axes in zip(space.modes, space.layout):
        for places in itertools.product(*(range(axis.start, axis.stop) for axis in axes)):
            column = np.zeros(len(space))
            column[list(places)] = 1 / len(places)
            columns.append(column)
            chosen = iter([place - axis.start for axis, place in zip(axes, places)])
            commands.append([
                nodes[next(chosen) if len(nodes) > 1 else 0] for nodes in mode.nodes])
    return np.array(columns).T, np.array(commands)
