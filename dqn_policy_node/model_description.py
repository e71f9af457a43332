# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a model is, apart from its weights: network, preprocessing, stack, actions, repeat."""
from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from typing import Any

from dqn_policy_node.action_space import ActionSpace, read_action_space
from dqn_policy_node.errors import ModelError
from msgs_bridge.plain_text import plain
from msgs_bridge.twists import Command

# of a frame, when a description of before they were written down does not say
FRAME_SIDE = 96
MAX_FRAME_SIDE = 4096
# of a held action, and between the observations of a stack
MAX_SECONDS = 60.0
GRAYS = ('mean', 'luma')
ROADS = ('plain', 'flat', 'contrast')
# model files and weights come from outside: no description may ask for more than this
MAX_PARAMETERS = 50_000_000
_CONVOLUTION = re.compile(r'(\d{1,4})@(\d{1,2})/(\d{1,2})')


def _check_seconds(name: str, value: Any) -> None:
    if type(value) is not float or not 0 < value <= MAX_SECONDS:
        raise ModelError(f'{name} is {value!r}; accepted: above 0, up to {MAX_SECONDS:g}')


def _check_whole(name: str, value: Any, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise ModelError(f'{name} is {value!r}; accepted: whole numbers from {low} to {high}')


@dataclasses.dataclass(frozen=True)
class Preprocessing:
    """
    From an rgb frame to the gray observation that the network sees.

    Attributes:
        frame_height, frame_width: size in pixels of the frames that the model learned from.
        first_row, rows, first_column, columns: the part of the frame that is kept.
        gray: 'mean' of the channels (the report, 2.1) or 'luma' (ITU-R BT.601).
        road: how the road is shown. CarRacing draws two of three unvisited tiles 1 or 2 %
            brighter than visited road. 'plain' leaves that as it is; 'flat' draws all road in
            one shade, so that visited road looks worth driving on; 'contrast' stretches the
            difference, so that a car that has spun can see where it has not been.
        shrink: side of the square of pixels that is averaged into one.
    """

    frame_height: int = FRAME_SIDE
    frame_width: int = FRAME_SIDE
    first_row: int = 0
    rows: int = FRAME_SIDE
    first_column: int = 0
    columns: int = FRAME_SIDE
    gray: str = 'mean'
    road: str = 'plain'
    shrink: int = 1

    def __post_init__(self) -> None:
        """Check the values; raises ModelError."""
        for side, first, count, what in (
            (self.frame_height, self.first_row, self.rows, 'row'),
            (self.frame_width, self.first_column, self.columns, 'column'),
        ):
            _check_whole(f'frame size across {what}s', side, 1, MAX_FRAME_SIDE)
            _check_whole(f'first_{what}', first, 0, side - 1)
            _check_whole(f'{what}s', count, 1, side - first)
        _check_whole('shrink', self.shrink, 1, 8)
        if self.rows % self.shrink or self.columns % self.shrink:
            raise ModelError(
                f'shrink {self.shrink} does not divide {self.rows} rows x {self.columns} columns')
        if self.gray not in GRAYS:
            raise ModelError(f'gray is {self.gray!r}; accepted: {", ".join(GRAYS)}')
        if self.road not in ROADS:
            raise ModelError(f'road is {self.road!r}; accepted: {", ".join(ROADS)}')

    @property
    def shape(self) -> tuple[int, int]:
        """Return height and width of the result in pixels."""
        return self.rows // self.shrink, self.columns // self.shrink


@dataclasses.dataclass(frozen=True)
class Convolution:
    """One convolutional layer: filters, and kernel and stride in pixels (square)."""

    filters: int
    kernel: int
    stride: int

    def __post_init__(self) -> None:
        """Check the values; raises ModelError."""
        _check_whole('filters', self.filters, 1, 512)
        _check_whole('kernel', self.kernel, 1, 32)
        _check_whole('stride', self.stride, 1, 16)


@dataclasses.dataclass(frozen=True)
class Network:
    """
    Shape of the network.

    Attributes:
        convolutions: the convolutional layers, each followed by ReLU.
        hidden: units of the fully connected layer.
        dueling: value and advantage streams, half of `hidden` each (arXiv 1511.06581).
        dropout: share of the second convolution's outputs that is dropped while learning.
        quantiles: of the return of each action, whose mean is its Q-value (arXiv 1710.10044); 1 is
            the Q-value itself.
    """

    convolutions: tuple[Convolution, ...]
    hidden: int
    dueling: bool = False
    dropout: float = 0.0
    quantiles: int = 1

    def __post_init__(self) -> None:
        """Check the values; raises ModelError."""
        if not 1 <= len(self.convolutions) <= 8:
            raise ModelError(f'{len(self.convolutions)} convolutions; accepted: 1 to 8')
        _check_whole('hidden', self.hidden, 2, 4096)
        if type(self.dueling) is not bool:
            raise ModelError(f'dueling is {self.dueling!r}; accepted: true or false')
        if self.dueling and self.hidden % 2:
            raise ModelError(f'hidden is {self.hidden}; dueling halves it, so it must be even')
        if not isinstance(self.dropout, (int, float)) or not 0 <= self.dropout <= 0.9:
            raise ModelError(f'dropout is {self.dropout!r}; accepted: 0 to 0.9')
        _check_whole('quantiles', self.quantiles, 1, 1024)


def parse_convolutions(text: str) -> tuple[Convolution, ...]:
    """
    Read layers written as FILTERS@KERNEL/STRIDE with spaces between, like '32@8/4 64@4/2'.

    Raises:
        ModelError: the text is not of that form or a number is out of range.
    """
    layers = []
    for part in text.split():
        match = _CONVOLUTION.fullmatch(part)
        if match is None:
            raise ModelError(
                f'convolution {plain(part)!r}; accepted: FILTERS@KERNEL/STRIDE, like 32@8/4')
        layers.append(Convolution(*map(int, match.groups())))
    return tuple(layers)


@dataclasses.dataclass(frozen=True)
class ModelDescription:
    """
    Everything about a model but its weights.

    Attributes:
        network: shape of the network.
        preprocessing: from frame to observation.
        frame_stack: observations that the network sees at once, oldest first.
        action_space: what its outputs mean.
        action_seconds: for which an action is held when driving.
        stack_seconds: between the observations of a stack.
    """

    network: Network
    preprocessing: Preprocessing
    frame_stack: int
    action_space: ActionSpace
    action_seconds: float
    stack_seconds: float

    def __post_init__(self) -> None:
        """Check what concerns more than one part; raises ModelError."""
        _check_whole('frame_stack', self.frame_stack, 1, 16)
        _check_seconds('action_seconds', self.action_seconds)
        _check_seconds('stack_seconds', self.stack_seconds)
        if self.parameters > MAX_PARAMETERS:
            raise ModelError(
                f'network of {self.parameters} weights; accepted: up to {MAX_PARAMETERS}')

    @property
    def features(self) -> tuple[int, int, int]:
        """
        Return channels, height and width after the last convolution.

        Raises:
            ModelError: the observation is too small for the layers.
        """
        channels, (height, width) = self.frame_stack, self.preprocessing.shape
        for layer in self.network.convolutions:
            if min(height, width) < layer.kernel:
                raise ModelError(
                    f'a kernel of {layer.kernel} does not fit on {height}x{width}; a smaller '
                    'shrink leaves more of a picture, smaller kernels or strides need less')
            channels = layer.filters
            height = (height - layer.kernel) // layer.stride + 1
            width = (width - layer.kernel) // layer.stride + 1
        return channels, height, width

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return name -> shape of every weight tensor."""
        shapes: dict[str, tuple[int, ...]] = {}
        channels = self.frame_stack
        for index, layer in enumerate(self.network.convolutions):
            shapes[f'convolutions.{index}.weight'] = (
                layer.filters, channels, layer.kernel, layer.kernel)
            shapes[f'convolutions.{index}.bias'] = (layer.filters,)
            channels = layer.filters
        channels, height, width = self.features
        hidden, quantiles = self.network.hidden, self.network.quantiles
        outputs = len(self.action_space) * quantiles
        shapes['hidden.weight'] = (hidden, channels * height * width)
        shapes['hidden.bias'] = (hidden,)
        if self.network.dueling:
            shapes['value.weight'] = (quantiles, hidden // 2)
            shapes['value.bias'] = (quantiles,)
            shapes['advantage.weight'] = (outputs, hidden // 2)
            shapes['advantage.bias'] = (outputs,)
        else:
            shapes['output.weight'], shapes['output.bias'] = (outputs, hidden), (outputs,)
        return shapes

    @property
    def parameters(self) -> int:
        """Return the number of weights."""
        total = 0
        for shape in self.shapes.values():
            size = 1
            for side in shape:
                size *= side
            total += size
        return total

    def to_json(self) -> dict[str, Any]:
        """Return the description as JSON values."""
        return {
            'network': dataclasses.asdict(self.network) | {
                'convolutions': [dataclasses.asdict(c) for c in self.network.convolutions]},
            'preprocessing': dataclasses.asdict(self.preprocessing),
            'frame_stack': self.frame_stack,
            'action_space': self.action_space.to_json(),
            'action_seconds': self.action_seconds,
            'stack_seconds': self.stack_seconds,
        }

    @classmethod
    def from_json(cls, values: Any) -> ModelDescription:
        """
        Read what `to_json` gives, from a source that is not trusted.

        Raises:
            ModelError: a key is missing or unknown, or a value is not accepted.
        """
        if isinstance(values, dict) and 'action_set' in values:
            values = _upgraded(values)
        values = _check_keys('model', values, cls)
        network = dict(_check_keys('network', values['network'], Network))
        layers = network['convolutions']
        if not isinstance(layers, list):
            raise ModelError('convolutions must be a list')
        network['convolutions'] = tuple(
            Convolution(**_check_keys('convolution', layer, Convolution)) for layer in layers)
        return cls(
            network=Network(**network),
            preprocessing=Preprocessing(
                **_check_keys('preprocessing', values['preprocessing'], Preprocessing)),
            frame_stack=values['frame_stack'],
            action_space=read_action_space(values['action_space']),
            action_seconds=values['action_seconds'],
            stack_seconds=values['stack_seconds'],
        )

    def sha256(self) -> str:
        """Return the hash of `to_json`."""
        return json_sha256(self.to_json())

    def differences(self, other: ModelDescription) -> list[str]:
        """Return a text for each value in which another description differs from this one."""
        return list(_differences('', self.to_json(), other.to_json()))


def json_sha256(values: Any) -> str:
    """Return the hash of JSON values, the same for equal ones."""
    return hashlib.sha256(
        json.dumps(values, sort_keys=True, separators=(',', ':')).encode()).hexdigest()


def _upgraded(values: dict[str, Any]) -> dict[str, Any]:
    """
    Return a description of version 0.1, in frames of 1/50 s and pedals, in today's form.

    Raises:
        ModelError: it is not of that form.
    """
    try:
        repeat, spacing = int(values['action_repeat']), int(values['stack_frames'])
        rows = [
            {'name': row['name'],
             **Command(row['gas'] - row['brake'], -row['steer'] + 0.0)._asdict()}
            for row in values['action_set']['actions']]
        return {
            'network': {'quantiles': 1, **values['network']},
            'preprocessing': {
                'frame_height': FRAME_SIDE, 'frame_width': FRAME_SIDE,
                **values['preprocessing']},
            'frame_stack': values['frame_stack'],
            'action_space': {
                'kind': 'discrete', 'name': values['action_set']['name'], 'actions': rows},
            'action_seconds': repeat / 50, 'stack_seconds': (spacing or repeat) / 50,
        }
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise ModelError(f'model: {type(error).__name__} {error}') from None


def _check_keys(what: str, values: Any, kind: type) -> dict[str, Any]:
    """Return the mapping if it has exactly the fields of a dataclass; raises ModelError."""
    names = {field.name for field in dataclasses.fields(kind)}
    if not isinstance(values, dict):
        raise ModelError(f'{what} must be a mapping, not {type(values).__name__}')
    for problem, keys in (
        ('lacks', names - values.keys()), ('has unknown', values.keys() - names),
    ):
        if keys:
            raise ModelError(f'{what} {problem} {", ".join(sorted(map(repr, keys)))}')
    return values


def _differences(path: str, mine: Any, other: Any) -> Any:
    if isinstance(mine, dict) and isinstance(other, dict) and mine.keys() == other.keys():
        for key in mine:
            yield from _differences(f'{path}.{key}' if path else key, mine[key], other[key])
    elif mine != other:
        yield f'{path} is {json.dumps(mine)}, not {json.dumps(other)}'
