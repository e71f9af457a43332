# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where networks run."""
from __future__ import annotations

import torch


def choose_device(name: str) -> str:
    """Return PyTorch's device name for auto (CUDA or ROCm when there), cpu or cuda."""
    if name != 'auto':
        return name
    return 'cuda' if torch.cuda.is_available() else 'cpu'
