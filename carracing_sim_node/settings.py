# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of CarRacing, each described once; they are parameters of its node."""
from __future__ import annotations

import dataclasses

from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class GymnasiumSettings:
    """What can be set on gymnasium's own CarRacing."""

    max_episode_frames: int = setting(
        1000, 'simulated frames after which an episode is truncated', low=1, high=10**6)
    frame_id: str = setting('car_top_down', 'frame_id of the images: x right, y down')


@dataclasses.dataclass(frozen=True)
class CarRacingSettings(GymnasiumSettings):
    """What can be set on CarRacing; the defaults are the unmodified environment."""

    early_end_frames: int = setting(
        0, 'variant, for training: truncate after this many frames without a new tile; '
        '0 = never', low=0, high=10**6)
    early_end_lap: bool = setting(
        False, 'variant, for training: truncate when the car has come round and missed tiles')
    zoom: bool = setting(True, 'false: variant without the zoom of the first second')
    domain_randomize: bool = setting(False, "true: gymnasium's variant with random colours")
    renderer: str = setting(
        'auto', "fast: ours; stock: gymnasium's; auto: fast where it is proven",
        choices=('auto', 'fast', 'stock'))
