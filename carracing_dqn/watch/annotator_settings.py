# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of image_annotator_node, each described once."""
from __future__ import annotations

import dataclasses

from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class AnnotatorSettings:
    """How the annotated picture looks."""

    rate: float = setting(20.0, 'most pictures a second of wall time', low=0.1, high=200.0)
    scale: int = setting(4, 'size of a pixel of the image in pixels of the picture; less where '
                         'the picture would be larger than 1280', low=1, high=20)
