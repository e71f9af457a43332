# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How long the bar of a number is, whatever numbers come."""
from __future__ import annotations

import math


def share_between(value: float, low: float, high: float) -> float:
    """Return where a value is between two others, 0 to 1; 0 where one of them is not finite."""
    if not all(map(math.isfinite, (value, low, high))) or high <= low:
        return 0.0
    # the difference of large numbers may be more than there is a number for
    scale = max(abs(low), abs(high))
    low, high, value = low / scale, high / scale, value / scale
    return min(max((value - low) / (high - low), 0.0), 1.0) if high > low else 0.0
