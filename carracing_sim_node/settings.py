# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of carracing_sim_node, each described once."""
from __future__ import annotations

import dataclasses

from msgs_bridge.settings import setting


@dataclasses.dataclass(frozen=True)
class SimulatorSettings:
    """What can be set on the simulator node; the defaults are the unmodified environment."""

    stepping: str = setting(
        'lockstep', 'lockstep waits for the twist that answers each frame; real_time runs at '
        '50 frames a second and holds the last twist', choices=('lockstep', 'real_time'))
    action_repeat: int = setting(
        1, 'simulator frames (1/50 s) per published frame; one twist drives all of them',
        low=1, high=50)
    seed: int = setting(
        42, 'seed of the first track (seed document 3.1: 42 training, 420 validation)',
        low=0, high=2**31 - 1)
    seed_each_episode: bool = setting(
        False, 'true: episode n drives the track of seed + n; false: seed once, then the stream '
        'of tracks that follows, as gymnasium does')
    first_episode: int = setting(
        0, 'number of the first episode; earlier ones are passed over, for resuming',
        low=0, high=10**9)
    episodes: int = setting(
        0, 'episodes to drive before the node ends; 0 = no end', low=0, high=10**9)
    max_episode_frames: int = setting(
        1000, 'simulator frames after which an episode is truncated', low=1, high=10**6)
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
    answer_timeout: float = setting(
        1.0, 'lockstep: seconds of wall time to wait for a twist before on_timeout',
        low=0.01, high=3600.0, live=True)
    on_timeout: str = setting(
        'resend', 'lockstep, nobody answered: send the same frame again, or go on and coast, '
        'or go on and hold the last twist', choices=('resend', 'coast', 'hold'), live=True)
    real_time_factor: float = setting(
        1.0, 'real_time: speed against the wall clock', low=0.01, high=100.0)
    stale_after: float = setting(
        0.25, 'real_time: seconds of wall time after which a held twist becomes zero',
        low=0.01, high=60.0, live=True)
    cmd_vel_stamped: bool = setting(
        True, 'false: cmd_vel is a plain Twist, taken as the answer to the newest frame')
    wait_for_subscribers: int = setting(
        0, "subscriptions of image_raw and step, beside the policy's, to wait for before the "
        'first frame, so that trainer and recorder miss nothing',
        low=0, high=100)
    start_paused: bool = setting(False, 'wait for ~/pause false or ~/step')
    frame_id: str = setting('car_top_down', 'frame_id of the images: x right, y down')
