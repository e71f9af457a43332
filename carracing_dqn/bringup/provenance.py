# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: versions and parameters, as JSON for its bag."""
from __future__ import annotations

import json

from trainer_node.run_folder import describe_machine


def provenance_text(**parameters: dict[str, object]) -> str:
    """Return code and library versions and the parameters of each node as a JSON object."""
    return json.dumps({'machine': describe_machine(), **parameters}, sort_keys=True)
