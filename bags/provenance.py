# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The origin of a run as the parameter `provenance` gives it and `custom_data` of a bag has it."""
from __future__ import annotations

import json

from bags.errors import BagError

# metadata.yaml holds it and has to stay readable; bytes
MOST_PROVENANCE = 1 << 20


def parse_provenance(text: str) -> dict[str, str]:
    """
    Return the entries of a JSON object as texts; an empty text has none.

    Raises:
        BagError: not a JSON object, or one that a bag cannot hold.
    """
    if not text:
        return {}
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BagError(f'provenance is not JSON: {error}') from None
    if not isinstance(values, dict):
        raise BagError('provenance is not a JSON object')
    data = {key: value if isinstance(value, str) else json.dumps(value)
            for key, value in values.items()}
    try:
        size = len(''.join((*data, *data.values())).encode())
    except UnicodeEncodeError:
        raise BagError('provenance holds half a surrogate pair, which is no text') from None
    if size > MOST_PROVENANCE:
        raise BagError(f'provenance has {size} bytes; accepted: up to {MOST_PROVENANCE}')
    return data
