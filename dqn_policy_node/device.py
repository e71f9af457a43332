# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where networks run."""
from __future__ import annotations

import torch

from dqn_policy_node.errors import ModelError
from msgs_bridge.plain_text import plain


def choose_device(name: str) -> torch.device:
    """
    Return PyTorch's device; 'auto' is CUDA or ROCm where it is there, the CPU otherwise.

    Raises:
        ModelError: the device is not there, or nothing can be computed on it.
    """
    if name == 'auto':
        name = 'cuda' if torch.cuda.is_available() else 'cpu'
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ModelError(
            f'device is {plain(name)!r}, which cannot be used here: '
            f'{plain(str(error).splitlines()[0])}; accepted: auto, cpu, cuda') from None
    return device
