# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What a model is, apart from its weights: network, preprocessing, stack, actions, repeat."""
from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from typing import Any

from dqn_policy_node.action_sets import ActionSet
from dqn_policy_node.errors import ModelError

FRAME_SIDE = 96
GRAYS = ('mean', 'luma')
ROADS = ('plain', 'flat', 'contrast')
# model files and weights come from outside: no description may ask for more than this
MAX_PARAMETERS = 50_000_000
_CONVOLUTION = re.compile(r'(\d{1,4})@(\d{1,2})/(\d{1,2})')


def _check_whole(name: str, value: Any, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise ModelError(f'{name} is {value!r}; accepted: whole numbers from {low} to {high}')


@dataclasses.dataclass(frozen=True)
class Preprocessing:
    """
    From an rgb frame to the gray observation that the network sees.

    Attributes:
        first_row, rows, first_column, columns: the part of the 96x96 frame that is kept.
        gray: 'mean' of the channels (the report, 2.1) or 'luma' (ITU-R BT.601).
        road: how the road is shown. CarRacing draws two of three unvisited tiles 1 or 2 %
            brighter than visited road. 'plain' leaves that as it is; 'flat' draws all road in
            one shade, so that visited road looks worth driving on; 'contrast' stretches the
            difference, so that a car that has spun can see where it has not been.
        shrink: side of the square of pixels that is averaged into one.
    """

    first_row: int = 0
    rows: int = FRAME_SIDE
    first_column: int = 0
    columns: int = FRAME_SIDE
    gray: str = 'mean'
    road: str = 'plain'
    shrink: int = 1

    def __post_init__(self) -> None:
        """Check the values; raises ModelError."""
        for first, count, what in (
            (self.first_row, self.rows, 'row'), (self.first_column, self.columns, 'column'),
        ):
            _check_whole(f'first_{what}', first, 0, FRAME_SIDE - 1)
            _check_whole(f'{what}s', count, 1, FRAME_SIDE - first)
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
    """

    convolutions: tuple[Convolution, ...]
    hidden: int
    dueling: bool = False
    dropout: float = 0.0

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
                f'convolution {part!r}; accepted: FILTERS@KERNEL/STRIDE, like 32@8/4')
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
        action_set: what its outputs mean.
        action_repeat: simulator frames (1/50 s) for which an action is held when driving.
        stack_frames: simulator frames between the observations of a stack; 0 = as `action_repeat`.
    """

    network: Network
    preprocessing: Preprocessing
    frame_stack: int
    action_set: ActionSet
    action_repeat: int
    stack_frames: int = 0

    def __post_init__(self) -> None:
        """Check what concerns more than one part; raises ModelError."""
        _check_whole('frame_stack', self.frame_stack, 1, 16)
        _check_whole('action_repeat', self.action_repeat, 1, 50)
        _check_whole('stack_frames', self.stack_frames, 0, 50)
        if self.stack_frames == 0:
            object.__setattr__(self, 'stack_frames', self.action_repeat)
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
                raise ModelError(f'a kernel of {layer.kernel} does not fit on {height}x{width}')
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
        hidden, actions = self.network.hidden, len(self.action_set)
        shapes['hidden.weight'] = (hidden, channels * height * width)
        shapes['hidden.bias'] = (hidden,)
        if self.network.dueling:
            shapes['value.weight'], shapes['value.bias'] = (1, hidden // 2), (1,)
            shapes['advantage.weight'] = (actions, hidden // 2)
            shapes['advantage.bias'] = (actions,)
        else:
            shapes['output.weight'], shapes['output.bias'] = (actions, hidden), (actions,)
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
            'action_set': self.action_set.to_json(),
            'action_repeat': self.action_repeat,
            'stack_frames': self.stack_frames,
        }

    @classmethod
    def from_json(cls, values: Any) -> ModelDescription:
        """
        Read what `to_json` gives, from a source that is not trusted.

        Raises:
            ModelError: a key is missing or unknown, or a value is not accepted.
        """
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
            action_set=ActionSet.from_json(values['action_set']),
            action_repeat=values['action_repeat'],
            stack_frames=values['stack_frames'],
        )

    def to_text(self) -> str:
        """Return the description as JSON, always the same for equal descriptions."""
        return json.dumps(self.to_json(), sort_keys=True, separators=(',', ':'))

    def sha256(self) -> str:
        """Return the hash of `to_text`."""
        return hashlib.sha256(self.to_text().encode()).hexdigest()

    def differences(self, other: ModelDescription) -> list[str]:
        """Return a text for each value in which another description differs from this one."""
        return list(_differences('', self.to_json(), other.to_json()))


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
