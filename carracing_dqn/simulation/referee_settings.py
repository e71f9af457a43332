# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of referee_node, each described once: what earns, what costs, what ends."""
from __future__ import annotations

import dataclasses

from msgs_bridge.errors import SettingsError
from msgs_bridge.settings import setting

TOPIC, PATH = 'topic', 'path'
# points that a term may give or take for one unit of what it looks at
MOST = 1e6


@dataclasses.dataclass(frozen=True)
class RefereeSettings:
    """A term with a weight of 0 and an end at 0 are off, and their topics are not needed."""

    forward_weight: float = setting(
        0.0, 'points for a metre ahead, by odom', low=-MOST, high=MOST)
    progress_weight: float = setting(
        0.0, 'points for a metre along path, by odom', low=-MOST, high=MOST)
    goal_weight: float = setting(
        0.0, 'points for a metre nearer to the goal, by goal_distance', low=-MOST, high=MOST)
    goal_reward: float = setting(
        0.0, 'points for reaching the goal', low=-MOST, high=MOST)
    lane_offset_penalty: float = setting(
        0.0, 'points off a second spent a metre off the middle of the lane', low=0.0, high=MOST)
    collision_penalty: float = setting(
        0.0, 'points off a frame with a collision', low=0.0, high=MOST)
    time_penalty: float = setting(0.0, 'points off a second', low=0.0, high=MOST)
    lane: str = setting(
        TOPIC, 'where the offset from the lane comes from: the topic lane_offset, or path and '
        'odom', choices=(TOPIC, PATH))
    collision_ends: bool = setting(False, 'a collision ends the episode: terminated')
    off_lane: float = setting(
        0.0, 'metres off the middle of the lane that end the episode: terminated; 0 = never',
        low=0.0, high=MOST)
    goal_radius: float = setting(
        0.0, 'metres from the goal at which it is reached: terminated; 0 = never',
        low=0.0, high=MOST)
    time_limit: float = setting(
        60.0, 'seconds of stamps after which the episode is cut off: truncated; 0 = never',
        low=0.0, high=1e6)
    reset_service: str = setting(
        '', 'std_srvs/Trigger service of the robot that is called after each episode; empty: '
        'there is none, and the next one begins where the robot is')
    reset_retry: float = setting(
        2.0, 'seconds of wall time after which an unanswered or refused reset is asked for again',
        low=0.1, high=600.0)
    sequence_gap: float = setting(
        0.5, 'seconds of stamps: a longer pause between two images cuts the episode off, and as '
        'long after an end the next one begins', low=0.05, high=60.0)
    input_timeout: float = setting(
        1.0, 'seconds of wall time to wait for what a frame is judged by; then no step is sent '
        'for it', low=0.05, high=60.0)
    twist_patience: float = setting(
        0.05, 'seconds of wall time to wait for the twist that answers the frame before; then '
        'the newest one counts as applied', low=0.0, high=10.0)
    stale_after: float = setting(
        0.5, 'seconds of stamps after which a twist no longer counts as applied',
        low=0.05, high=10.0)
    frame_seconds: float = setting(
        0.05, 'seconds between two images, as told in episode', low=1e-4, high=10.0)
    wait_for_subscribers: int = setting(
        0, 'subscriptions of step to wait for before the first episode', low=0, high=100)
    camera_compressed: bool = setting(
        False, 'true: image_raw is a CompressedImage; its stamps are all that is looked at')

    def __post_init__(self) -> None:
        """Check what concerns two values; raises SettingsError."""
        if self.goal_reward and not self.goal_radius:
            raise SettingsError(f'goal_reward is {self.goal_reward:g}, which nothing earns while '
                                'goal_radius is 0: give goal_radius, how near is there')
