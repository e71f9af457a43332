# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Safetensors images from sources that are not trusted: checked before anything is used."""
from __future__ import annotations

import hashlib
import json

import numpy as np
import safetensors
import safetensors.torch
import torch

from dqn_policy_node.errors import ModelError
from dqn_policy_node.model_description import ModelDescription

MAX_BYTES = 256 * 2**20
MAX_HEADER_BYTES = 2**20


def read_metadata(data: bytes) -> dict[str, str]:
    """
    Return the metadata of a safetensors image.

    Raises:
        ModelError: the image is too short, too long, or its header is not JSON.
    """
    if not 8 <= len(data) <= MAX_BYTES:
        raise ModelError(f'weights image of {len(data)} bytes; accepted: 8 to {MAX_BYTES}')
    length = int.from_bytes(data[:8], 'little')
    if length > min(MAX_HEADER_BYTES, len(data) - 8):
        raise ModelError(f'weights image is cut off or no safetensors: header of {length} bytes')
    try:
        metadata = json.loads(data[8:8 + length]).get('__metadata__', {})
    except (ValueError, AttributeError, RecursionError):
        raise ModelError('weights image has a header that is not JSON') from None
    if not isinstance(metadata, dict):
        raise ModelError('weights image has metadata that is no mapping')
    return metadata


def tensors_sha256(tensors: dict[str, torch.Tensor]) -> str:
    """Return the hash over names, shapes and values, whatever their order in memory."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name].detach().cpu().numpy())
        digest.update(f'{name} {array.dtype.str} {array.shape}\n'.encode())
        digest.update(array.data)
    return digest.hexdigest()


def pack(tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> bytes:
    """Return a safetensors image of the weights, float32 in plain layout."""
    plain = {
        name: tensor.detach().to('cpu', torch.float32).contiguous()
        for name, tensor in tensors.items()}
    return safetensors.torch.save(plain, metadata)


def unpack(data: bytes, description: ModelDescription) -> dict[str, torch.Tensor]:
    """
    Return the weights of an image: every tensor of the description, finite, and no other.

    Raises:
        ModelError: not safetensors, or a tensor that is missing, foreign, of another shape or
            type, or not finite.
    """
    if len(data) > MAX_BYTES:
        raise ModelError(f'weights image of {len(data)} bytes; accepted: up to {MAX_BYTES}')
    try:
        tensors = safetensors.torch.load(data)
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ModelError(f'weights image is not safetensors: {error}') from None
    shapes = description.shapes
    for problem, names in (
        ('lacks', shapes.keys() - tensors.keys()), ('has unknown', tensors.keys() - shapes.keys()),
    ):
        if names:
            raise ModelError(f'weights image {problem} tensor {sorted(names)[0]!r}')
    for name, shape in shapes.items():
        tensor = tensors[name]
        if tensor.dtype != torch.float32 or tuple(tensor.shape) != shape:
            raise ModelError(f'weights {name!r} are {tensor.dtype} {tuple(tensor.shape)}; '
                             f'expected torch.float32 {shape}')
        if not torch.isfinite(tensor).all():
            raise ModelError(f'weights {name!r} are not all finite')
    return tensors
